//! From errno to an error that recovery can decide on and a person can act on.

use crate::error::{DeviceError, ErrorKind};
use std::io;

/// Makes errors of the device of this name.
#[derive(Debug, Clone, Copy)]
pub struct Fault<'a>(pub &'a str);

// === impl Fault ===

impl Fault<'_> {
    /// An error with a sentence of ours.
    pub fn of(&self, kind: ErrorKind, message: impl Into<String>) -> DeviceError {
        DeviceError::new(kind, self.0, message)
    }

    /// The error that errno means while doing `what`.
    pub fn io(&self, what: &str, error: &io::Error) -> DeviceError {
        let (kind, hint) = match error.raw_os_error() {
            Some(libc::ENODEV | libc::ENXIO | libc::ENOENT) => {
                (ErrorKind::Lost, "the camera is not there; check plug and power, it is opened again by its node")
            }
            Some(libc::EBUSY) => (ErrorKind::Busy, "another program uses the camera; close it"),
            Some(libc::EACCES | libc::EPERM) => {
                (ErrorKind::Refused, "the daemon may not open it; its user needs group video")
            }
            Some(libc::EINVAL | libc::ERANGE | libc::ENOTTY) => (
                ErrorKind::Refused,
                "the camera's driver does not offer that; compare the configuration with `v4l2-ctl --all`",
            ),
            Some(libc::ETIMEDOUT) => (ErrorKind::Timeout, "the camera did not answer"),
            _ => (ErrorKind::Broken, "the camera's driver reports a fault"),
        };
        self.of(kind, format!("{what} failed ({error}): {hint}"))
    }
}
