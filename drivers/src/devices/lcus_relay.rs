//! Driver `lcus-relay`: USB relay boards LCUS-1, -2, -4, -8 (CH340) with a shutter on channel 1.
//!
//! Source: vendor pages of the board family as collected in the protocol sheet `usb-relay-lcus`. The shutter hangs on the
//! normally-open contact, so power loss closes it. Open loop: see [`open_loop`](super::open_loop). The adapter has no
//! serial number; name it by its USB path.

use super::open_loop::{OpenLoop, Orders};
use super::thorlabs_sc10::ShutterConfig;
use crate::clock::Clock;
use crate::contract::Shutter;
use crate::transport::Connector;
use std::time::Duration;

/// Line of the board.
pub const BAUD: u32 = 9600;
/// Frames `A0 channel state sum`; the contact bounces 10 ms, the solenoid behind it is given as long as a blade.
const ORDERS: Orders = Orders {
    model: "LCUS relay, channel 1",
    open: &[0xA0, 0x01, 0x01, 0xA2],
    close: &[0xA0, 0x01, 0x00, 0xA1],
    travel: Duration::from_millis(50),
};

/// A shutter over `connector`; nothing is sent before `open`.
pub fn shutter(connector: Box<dyn Connector>, config: ShutterConfig, clock: Clock) -> Box<dyn Shutter> {
    Box::new(OpenLoop::new(ORDERS, connector, config, clock))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_frame_ends_with_the_sum_of_its_bytes() {
        for frame in [ORDERS.open, ORDERS.close] {
            let (sum, body) = frame.split_last().unwrap_or((&0, &[]));
            assert_eq!(body.iter().fold(0_u8, |s, b| s.wrapping_add(*b)), *sum);
        }
    }
}
