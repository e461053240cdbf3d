//! USB pipes: what a driver may ask of a claimed interface. libusb is one implementation; a twin in memory another.
//!
//! The calls of [`UsbPort`] block, as libusb's do, so a port lives on a named thread of its own; drivers speak to it
//! through [`UsbConnector`]s and never block the runtime.

use crate::error::{DeviceError, Result};
use std::time::Duration;

/// What a transfer can end with, besides success.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum UsbError {
    /// Nothing came (or was taken) within the limit.
    Timeout,
    /// The endpoint is halted: clear it before the next transfer.
    Stall,
    /// More came than was asked for.
    Overflow,
    /// The device is gone.
    Gone,
    /// Anything else libusb says.
    Other,
}

/// Result of a transfer.
pub type Transfer<T> = std::result::Result<T, UsbError>;

/// A control request on endpoint 0: the eight bytes of a setup packet less the length.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Setup {
    /// bmRequestType: direction, type, recipient.
    pub request_type: u8,
    /// bRequest.
    pub request: u8,
    /// wValue.
    pub value: u16,
    /// wIndex.
    pub index: u16,
}

/// One opened device with its interface claimed. Every call blocks for at most `limit`.
pub trait UsbPort: Send {
    /// Serial number of the device descriptor; empty where it has none.
    fn serial(&self) -> &str;
    /// Vendor and product id.
    fn ids(&self) -> (u16, u16);
    /// Writes to a bulk endpoint; gives the number of bytes taken.
    fn bulk_out(&mut self, endpoint: u8, bytes: &[u8], limit: Duration) -> Transfer<usize>;
    /// Reads from a bulk endpoint, at most `length` bytes, up to a short packet. Part of the data is a success.
    fn bulk_in(&mut self, endpoint: u8, length: usize, limit: Duration) -> Transfer<Vec<u8>>;
    /// A control transfer to the device.
    fn control_out(&mut self, setup: Setup, bytes: &[u8], limit: Duration) -> Transfer<usize>;
    /// A control transfer from the device.
    fn control_in(&mut self, setup: Setup, length: usize, limit: Duration) -> Transfer<Vec<u8>>;
    /// Clears a halted endpoint on both sides.
    fn clear_halt(&mut self, endpoint: u8) -> Transfer<()>;
}

/// Opens a USB device, again and again; blocking, so only the port's own thread calls it.
pub trait UsbConnector: Send {
    /// The device as the instrument file names it (`usb:1313:8072:P0010203`), for messages.
    fn port(&self) -> &str;
    /// Finds the device by ids and serial number, opens it and claims its interface; `Lost` when it is not there.
    fn connect(&mut self) -> Result<Box<dyn UsbPort>>;
}

// === impl UsbError ===

impl UsbError {
    /// The error of a device that recovery can decide on.
    pub fn of(self, device: &str, doing: &str) -> DeviceError {
        use crate::error::ErrorKind;
        let (kind, what) = match self {
            UsbError::Timeout => (ErrorKind::Timeout, "nothing came within the limit"),
            UsbError::Stall => (ErrorKind::Refused, "the device halted the endpoint"),
            UsbError::Overflow => (ErrorKind::Garbled, "more bytes came than were asked for"),
            UsbError::Gone => (ErrorKind::Lost, "the device is gone; check cable and power"),
            UsbError::Other => (ErrorKind::Lost, "the USB transfer failed; pull the cable and plug it in again"),
        };
        DeviceError::new(kind, device, format!("{doing}: {what}"))
    }
}
