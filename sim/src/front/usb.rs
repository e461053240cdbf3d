//! USB devices in software, seen from their endpoints: the same twin serves a driver in memory and a kernel through USB/IP.

use tokio::time::Instant;

/// What a device answers to a transfer.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Answer {
    /// Bytes (IN; more than asked for is an overflow) or the acceptance of all bytes (OUT, empty).
    Data(Vec<u8>),
    /// Not ready: the host waits and asks again.
    Nak,
    /// The endpoint is halted, or the request is unknown.
    Stall,
}

/// The eight bytes of a setup packet.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SetupPacket {
    /// bmRequestType.
    pub request_type: u8,
    /// bRequest.
    pub request: u8,
    /// wValue.
    pub value: u16,
    /// wIndex.
    pub index: u16,
    /// wLength.
    pub length: u16,
}

/// Bus speed, with the numbers USB/IP uses.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Speed {
    /// 12 Mbit/s.
    Full = 2,
    /// 480 Mbit/s.
    High = 3,
}

/// A USB device as a state machine of time. Standard requests (descriptors, configuration, clear halt) are answered
/// by the front from [`UsbTwin::descriptors`]; all others reach the twin.
pub trait UsbTwin: Send + 'static {
    /// Device and configuration descriptors and strings, which never change while it is plugged in.
    fn descriptors(&self) -> Descriptors;
    /// A class or vendor request on endpoint 0; `bytes` are those of an OUT request.
    fn control(&mut self, setup: SetupPacket, bytes: &[u8], now: Instant) -> Answer;
    /// Bytes for an OUT endpoint.
    fn bulk_out(&mut self, endpoint: u8, bytes: &[u8], now: Instant) -> Answer;
    /// At most `length` bytes from an IN endpoint (address with its top bit).
    fn bulk_in(&mut self, endpoint: u8, length: usize, now: Instant) -> Answer;
    /// The host cleared a halted endpoint.
    fn clear_halt(&mut self, endpoint: u8, now: Instant);
    /// The host reset or configured the device: transfers under way are gone.
    fn reset(&mut self, now: Instant);
    /// When a bulk IN endpoint that said `Nak` may have something; `None` while only a transfer can change that.
    fn due(&self) -> Option<Instant>;
    /// True once when the device has left the bus by itself (a restart): its host sees it go, and finds it anew.
    fn left_bus(&mut self) -> bool {
        false
    }
}

/// What a device says of itself.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Descriptors {
    /// The 18 bytes of the device descriptor.
    pub device: Vec<u8>,
    /// Configuration descriptor with all its interfaces and endpoints.
    pub configuration: Vec<u8>,
    /// Strings by index from 1.
    pub strings: Vec<String>,
    /// Bus speed.
    pub speed: Speed,
}
