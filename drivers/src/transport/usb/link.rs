//! One open USB device on the async side: transfers in the words of the drivers.

use super::{Setup, Transfer, UsbError, UsbInfo, UsbPipe, UsbRequest};
use std::time::Duration;

/// Reads of one drain before a device that never stops sending is given up.
const MOST_DRAINS: usize = 256;
/// Limit for clearing a halt.
const HALT_LIMIT: Duration = Duration::from_secs(1);

/// An open device: its descriptors and its pipe.
pub struct UsbLink {
    pipe: Box<dyn UsbPipe>,
    info: UsbInfo,
}

// === impl UsbLink ===

impl UsbLink {
    /// A link over `pipe` to the device that `info` describes.
    pub fn new(pipe: impl UsbPipe + 'static, info: UsbInfo) -> UsbLink {
        UsbLink { pipe: Box::new(pipe), info }
    }

    /// What the device's descriptors say.
    pub fn info(&self) -> &UsbInfo {
        &self.info
    }

    /// Largest packet of a bulk endpoint; 64 bytes where the descriptors do not name it.
    pub fn packet(&self, endpoint: u8) -> usize {
        let found = self.info.endpoints.iter().find(|e| e.address == endpoint);
        found.map_or(64, |e| e.packet.max(1))
    }

    /// All of `bytes` to a bulk endpoint; [`UsbError::Partial`] when the device took only some within `limit`.
    pub async fn send(&mut self, endpoint: u8, bytes: &[u8], limit: Duration) -> Transfer<()> {
        self.pipe.transfer(UsbRequest::BulkOut(endpoint, bytes.to_vec()), limit).await.map(drop)
    }

    /// Up to `length` bytes from a bulk endpoint, to a short packet. The buffer is a multiple of the packet size, since
    /// a packet that does not fit is lost; so up to one packet less a byte more than `length` may come.
    pub async fn read(&mut self, endpoint: u8, length: usize, limit: Duration) -> Transfer<Vec<u8>> {
        let room = length.max(1).next_multiple_of(self.packet(endpoint));
        self.pipe.transfer(UsbRequest::BulkIn(endpoint, room), limit).await
    }

    /// Throws away what waits in an IN endpoint, in reads of `room` bytes, until nothing comes for `quiet`; gives the
    /// number of bytes. A halt that it meets is cleared.
    pub async fn drain(&mut self, endpoint: u8, room: usize, quiet: Duration) -> Transfer<usize> {
        let mut thrown = 0;
        for _ in 0..MOST_DRAINS {
            match self.read(endpoint, room, quiet).await {
                Ok(bytes) => thrown += bytes.len(),
                Err(UsbError::Timeout) => return Ok(thrown),
                Err(UsbError::Stall) => self.clear_halt(endpoint).await?,
                Err(UsbError::Overflow) => thrown += room,
                Err(error) => return Err(error),
            }
        }
        Err(UsbError::Overflow)
    }

    /// A control request from the device.
    pub async fn control_in(&mut self, setup: Setup, length: usize, limit: Duration) -> Transfer<Vec<u8>> {
        self.pipe.transfer(UsbRequest::ControlIn(setup, length), limit).await
    }

    /// A control request to the device.
    pub async fn control_out(&mut self, setup: Setup, bytes: &[u8], limit: Duration) -> Transfer<()> {
        self.pipe.transfer(UsbRequest::ControlOut(setup, bytes.to_vec()), limit).await.map(drop)
    }

    /// Clears a halted endpoint on both sides.
    pub async fn clear_halt(&mut self, endpoint: u8) -> Transfer<()> {
        self.pipe.transfer(UsbRequest::ClearHalt(endpoint), HALT_LIMIT).await.map(drop)
    }
}
