//! Features of a camera, written and read back, and what the library's errors mean for recovery.

use crate::error::{DeviceError as Failure, ErrorKind, Result};
use aravis::prelude::*;
use aravis::{Device, DeviceError, GcError, glib};

/// A camera's feature tree with the name its messages carry.
pub struct Features {
    device: Device,
    label: String,
}

/// What an error of the library means.
pub fn kind(error: &glib::Error) -> ErrorKind {
    if let Some(kind) = error.kind::<DeviceError>() {
        return match kind {
            DeviceError::Timeout => ErrorKind::Timeout,
            DeviceError::NotConnected
            | DeviceError::NotFound
            | DeviceError::NotController
            | DeviceError::TransferError
            | DeviceError::ProtocolErrorAccessDenied => ErrorKind::Lost,
            DeviceError::ProtocolErrorBusy => ErrorKind::Busy,
            DeviceError::ProtocolErrorInvalidParameter
            | DeviceError::ProtocolErrorWriteProtect
            | DeviceError::FeatureNotFound
            | DeviceError::WrongFeature => ErrorKind::Refused,
            _ => ErrorKind::Garbled,
        };
    }
    match error.kind::<GcError>() {
        Some(GcError::OutOfRange | GcError::ReadOnly | GcError::EnumEntryNotFound) => ErrorKind::Refused,
        _ => ErrorKind::Garbled,
    }
}

// === impl Features ===

impl Features {
    /// The features of an open device.
    pub fn new(device: Device, label: String) -> Features {
        Features { device, label }
    }

    /// The device itself.
    pub fn device(&self) -> &Device {
        &self.device
    }

    /// An error of this camera.
    pub fn fail(&self, kind: ErrorKind, message: impl Into<String>) -> Failure {
        Failure::new(kind, self.label.clone(), message)
    }

    /// An error of the library, with what was attempted.
    pub fn wrap(&self, doing: &str, error: &glib::Error) -> Failure {
        self.fail(kind(error), format!("{doing}: {}", error.message()))
    }

    /// True where the camera offers the feature.
    pub fn has(&self, name: &str) -> bool {
        self.device.is_feature_available(name).unwrap_or(false)
    }

    /// The first of several names that the camera offers (old and new spellings).
    pub fn first<'a>(&self, names: &[&'a str]) -> Option<&'a str> {
        names.iter().copied().find(|name| self.has(name))
    }

    /// A text or enumeration feature.
    pub fn text(&self, name: &str) -> Result<String> {
        let value = self.device.string_feature_value(name);
        value.map(|v| v.to_string()).map_err(|e| self.wrap(&format!("reading {name}"), &e))
    }

    /// A whole-number feature.
    pub fn integer(&self, name: &str) -> Result<i64> {
        self.device.integer_feature_value(name).map_err(|e| self.wrap(&format!("reading {name}"), &e))
    }

    /// A number feature.
    pub fn float(&self, name: &str) -> Result<f64> {
        self.device.float_feature_value(name).map_err(|e| self.wrap(&format!("reading {name}"), &e))
    }

    /// Runs a command feature.
    pub fn execute(&self, name: &str) -> Result<()> {
        self.device.execute_command(name).map_err(|e| self.wrap(&format!("executing {name}"), &e))
    }

    /// Writes an enumeration entry and proves it.
    pub fn set_text(&self, name: &str, value: &str) -> Result<()> {
        let written = self.device.set_string_feature_value(name, value);
        written.map_err(|e| self.wrap(&format!("setting {name} to {value}"), &e))?;
        let read = self.text(name)?;
        if read == value { Ok(()) } else { Err(self.mismatch(name, &value, &read)) }
    }

    /// Writes a whole number and proves it.
    pub fn set_integer(&self, name: &str, value: i64) -> Result<()> {
        let written = self.device.set_integer_feature_value(name, value);
        written.map_err(|e| self.wrap(&format!("setting {name} to {value}"), &e))?;
        let read = self.integer(name)?;
        if read == value { Ok(()) } else { Err(self.mismatch(name, &value, &read)) }
    }

    /// Writes a switch and proves it.
    pub fn set_switch(&self, name: &str, value: bool) -> Result<()> {
        let written = self.device.set_boolean_feature_value(name, value);
        written.map_err(|e| self.wrap(&format!("setting {name} to {value}"), &e))?;
        let read = self.device.boolean_feature_value(name).map_err(|e| self.wrap(&format!("reading {name}"), &e))?;
        if read == value { Ok(()) } else { Err(self.mismatch(name, &value, &read)) }
    }

    /// Writes a number and gives what the camera made of it; more than `tolerance` away is an error.
    pub fn set_float(&self, name: &str, value: f64, tolerance: f64) -> Result<f64> {
        let written = self.device.set_float_feature_value(name, value);
        written.map_err(|e| self.wrap(&format!("setting {name} to {value}"), &e))?;
        let read = self.float(name)?;
        if (read - value).abs() <= tolerance { Ok(read) } else { Err(self.mismatch(name, &value, &read)) }
    }

    fn mismatch(&self, name: &str, wrote: &dyn std::fmt::Display, read: &dyn std::fmt::Display) -> Failure {
        let message = format!("{name} was set to {wrote} and reads back {read}; power-cycle the camera");
        self.fail(ErrorKind::Broken, message)
    }
}
