//! Driver `uniblitz-vcm-d1`: one-byte serial shutter drivers VCM-D1, VMM-D1 and VMM-T1 (Vincent Associates).
//!
//! Source: VMM-T1 manual, Openlab technical note 152, as collected in the protocol sheet `uniblitz-vcm-d1`. Open loop:
//! see [`open_loop`](super::open_loop) for what its state means.

use super::open_loop::{OpenLoop, Orders};
use super::thorlabs_sc10::ShutterConfig;
use crate::clock::Clock;
use crate::contract::Shutter;
use crate::transport::Connector;
use std::time::Duration;

/// Line of the box.
pub const BAUD: u32 = 9600;
/// `@` opens, `A` closes; heads of 25 mm travel 35 ms.
const ORDERS: Orders = Orders { model: "Uniblitz VCM-D1", open: b"@", close: b"A", travel: Duration::from_millis(35) };

/// A shutter over `connector`; nothing is sent before `open`.
pub fn shutter(connector: Box<dyn Connector>, config: ShutterConfig, clock: Clock) -> Box<dyn Shutter> {
    Box::new(OpenLoop::new(ORDERS, connector, config, clock))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_bytes_are_those_of_the_sheet() {
        assert_eq!((ORDERS.open, ORDERS.close), (&[0x40_u8][..], &[0x41_u8][..]));
    }
}
