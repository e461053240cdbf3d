//! Firmware twins: each answers its device's bytes and moves its mechanics, as plain state machines of time.
//!
//! A twin gets bytes and an instant, and gives bytes that are due at an instant. It never waits and never reads a clock,
//! so its truth can be asked for any instant, past or present. Faults are injected as values.

pub mod fw212c;
pub mod motion;
pub mod outbox;
pub mod prompt;
pub mod sc10;
pub mod usb;
pub mod zaber;
mod zaber_axis;

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
