//! Firmware twins: each answers its device's bytes and moves its mechanics, as plain state machines of time.
//!
//! A twin gets bytes and an instant, and gives bytes that are due at an instant. It never waits and never reads a clock,
//! so its truth can be asked for any instant, past or present. Faults are injected as values.

pub mod cm110;
pub mod esp301;
mod esp301_axis;
mod esp301_programs;
mod esp301_settings;
pub mod fw212c;
pub mod ifw;
pub mod models;
pub mod motion;
pub mod newport_1830c;
pub mod open_shutter;
pub mod outbox;
pub mod prompt;
pub mod sc10;
pub mod smc100;
mod smc100_box;
pub mod usb;
pub mod zaber;
mod zaber_axis;
mod zaber_request;
mod zaber_stage;

use tokio::time::Instant;

/// A device's firmware, seen from its wire.
pub trait Firmware: Send + 'static {
    /// Bytes arrive at `now`.
    fn receive(&mut self, bytes: &[u8], now: Instant);
    /// When the next bytes leave; `None` while there is nothing to say.
    fn due(&self) -> Option<Instant>;
    /// The bytes that have left by `now`.
    fn take(&mut self, now: Instant) -> Vec<u8>;
    /// A host has opened the port at `now`: what was said to nobody is gone.
    fn connected(&mut self, now: Instant);
}

pub use outbox::WireFault;
