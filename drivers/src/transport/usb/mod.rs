//! USB pipes: what a driver may ask of a claimed interface. libusb on a thread of its own is one implementation
//! ([`UsbThread`]); a twin in memory, in tokio's time, another.
//!
//! A driver holds a [`UsbConnector`], never a device: after a loss it connects again through the same object, and the
//! device is found anew by its ids and serial number, whatever address it has got.

mod address;
#[cfg(feature = "usb")]
mod libusb;
mod link;
mod thread;

pub use address::UsbAddress;
#[cfg(feature = "usb")]
pub use libusb::LibUsb;
pub use link::UsbLink;
pub use thread::UsbThread;

use crate::error::{DeviceError, ErrorKind, Result};
use async_trait::async_trait;
use std::time::Duration;

/// What a transfer can end with, besides success.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum UsbError {
    /// Nothing came (or was taken) within the limit.
    Timeout,
    /// Only this many bytes of an OUT transfer were taken within the limit.
    Partial(usize),
    /// The endpoint is halted, or the device does not know the request.
    Stall,
    /// More came than was asked for; what came is lost.
    Overflow,
    /// The device is gone.
    Gone,
    /// The call into the USB library did not come back; its thread is left to itself.
    Hangs,
    /// Anything else the USB library says.
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

/// One transfer or one change of an endpoint.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum UsbRequest {
    /// Bytes for a bulk OUT endpoint.
    BulkOut(u8, Vec<u8>),
    /// At most so many bytes from a bulk IN endpoint, up to a short packet. Part of the data is a success.
    BulkIn(u8, usize),
    /// A control request with these bytes.
    ControlOut(Setup, Vec<u8>),
    /// A control request for at most so many bytes.
    ControlIn(Setup, usize),
    /// Clears a halted endpoint on both sides, which resets its data toggle.
    ClearHalt(u8),
}

/// A bulk endpoint of the claimed interface.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct BulkEndpoint {
    /// Address; the top bit is set for IN.
    pub address: u8,
    /// Largest packet in bytes.
    pub packet: usize,
}

/// What an opened device says of itself in its descriptors.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct UsbInfo {
    /// Vendor id.
    pub vendor: u16,
    /// Product id.
    pub product: u16,
    /// Manufacturer string; empty where there is none.
    pub manufacturer: String,
    /// Product string; empty where there is none.
    pub name: String,
    /// Serial number string; empty where there is none.
    pub serial: String,
    /// Number of the claimed interface.
    pub interface: u8,
    /// Class, subclass and protocol of the claimed interface.
    pub class: (u8, u8, u8),
    /// Bulk endpoints of the claimed interface.
    pub endpoints: Vec<BulkEndpoint>,
}

/// One opened device with its interface claimed, as a blocking library gives it: lives on a [`UsbThread`].
pub trait UsbPort: Send {
    /// What its descriptors say.
    fn info(&self) -> UsbInfo;
    /// Carries out one request; blocks for about `limit` at most. IN requests give their bytes, all others nothing.
    fn transfer(&mut self, request: &UsbRequest, limit: Duration) -> Transfer<Vec<u8>>;
}

/// Finds and opens a device, again and again, with blocking calls: lives on a [`UsbThread`].
pub trait UsbOpener: Send + Sync {
    /// The device as the instrument file names it (`usb:1313:8072:P0010203`), for messages.
    fn port(&self) -> &str;
    /// Finds the device by ids and serial number, opens it and claims its interface; `Lost` when it is not there.
    fn open(&self) -> Result<Box<dyn UsbPort>>;
}

/// One opened device on the async side. A future that is dropped leaves its transfer to end by its own limit; the next
/// request waits for that.
#[async_trait]
pub trait UsbPipe: Send {
    /// Carries out one request within about `limit`. IN requests give their bytes, all others nothing.
    async fn transfer(&mut self, request: UsbRequest, limit: Duration) -> Transfer<Vec<u8>>;
}

/// Opens a USB device, again and again.
#[async_trait]
pub trait UsbConnector: Send {
    /// The device as the instrument file names it (`usb:1313:8072:P0010203`), for messages.
    fn port(&self) -> &str;
    /// Finds the device by ids and serial number, opens it and claims its interface; `Lost` when it is not there.
    async fn connect(&mut self) -> Result<UsbLink>;
}

// === impl UsbError ===

impl UsbError {
    /// The error of a device that recovery can decide on.
    pub fn of(self, device: &str, doing: &str) -> DeviceError {
        let (kind, what) = match self {
            UsbError::Timeout => (ErrorKind::Timeout, "nothing came within the limit".to_owned()),
            UsbError::Partial(n) => (ErrorKind::Timeout, format!("the device took only {n} bytes within the limit")),
            UsbError::Stall => (ErrorKind::Refused, "the device halted the endpoint".to_owned()),
            UsbError::Overflow => (ErrorKind::Garbled, "more bytes came than were asked for".to_owned()),
            UsbError::Gone => (ErrorKind::Lost, "the device is gone; check cable and power".to_owned()),
            UsbError::Hangs => {
                (ErrorKind::Lost, "a call into the USB library hangs and is left; open the device again".to_owned())
            }
            UsbError::Other => {
                (ErrorKind::Lost, "the USB transfer failed; pull the cable and plug it in again".to_owned())
            }
        };
        DeviceError::new(kind, device, format!("{doing}: {what}"))
    }

    /// True when the device must be connected anew.
    pub fn is_loss(self) -> bool {
        matches!(self, UsbError::Gone | UsbError::Hangs | UsbError::Other)
    }
}

// === impl UsbInfo ===

impl UsbInfo {
    /// First bulk OUT and first bulk IN endpoint.
    pub fn bulk_pair(&self) -> Option<(BulkEndpoint, BulkEndpoint)> {
        let first = |input: bool| self.endpoints.iter().copied().find(|e| (e.address & 0x80 != 0) == input);
        Some((first(false)?, first(true)?))
    }
}
