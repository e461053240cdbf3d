//! One error a device can give: its kind is what recovery decides on, its text is for the person who must act.

use serde::{Deserialize, Serialize};
use thiserror::Error;

/// What went wrong, in the words recovery needs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ErrorKind {
    /// The device works on something else; ask again later.
    Busy,
    /// No answer within the deadline; whether the command was carried out is unknown.
    Timeout,
    /// An answer came that is not in the protocol, fails its checksum or belongs to another request.
    Garbled,
    /// The device understood and said no, or the driver refused before sending (limits, interlock).
    Refused,
    /// The link is gone (unplugged, closed, port not there).
    Lost,
    /// The device answers, but is not the one the configuration names.
    WrongDevice,
    /// The device answers and reports a fault of its own, or does not reach what it was told to.
    Broken,
}

/// An error of a device: which one, what kind, and a sentence for a person.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[error("{device}: {message}")]
pub struct DeviceError {
    /// Kind for recovery.
    pub kind: ErrorKind,
    /// The device as the instrument file names it, with its port.
    pub device: String,
    /// What happened and what is allowed or to be done, one sentence without full stop.
    pub message: String,
}

/// Result of anything a device does.
pub type Result<T> = std::result::Result<T, DeviceError>;

// === impl DeviceError ===

impl DeviceError {
    /// An error of `kind` of `device` with a sentence for a person.
    pub fn new(kind: ErrorKind, device: impl Into<String>, message: impl Into<String>) -> DeviceError {
        DeviceError { kind, device: device.into(), message: message.into() }
    }
}
