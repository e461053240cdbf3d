//! Twins of shutters that only listen: the one-byte Uniblitz boxes and the LCUS relay board.
//!
//! Source: the protocol sheets `uniblitz-vcm-d1` and `usb-relay-lcus`. Neither ever answers; a blade travels behind them.

use super::Firmware;
use super::motion::Track;
use std::time::Duration;
use tokio::time::Instant;

/// Time to take up a byte.
const BYTE: Duration = Duration::from_millis(1);
/// Blade travel per second (1 = the whole way): 30 ms.
const BLADE_SPEED: f64 = 1.0 / 0.03;
/// A triggered exposure as set on the box.
const TRIGGERED: Duration = Duration::from_millis(500);
/// First byte of a relay frame.
const FRAME: u8 = 0xA0;

/// Which box listens.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Listener {
    /// VCM-D1, VMM-D1, VMM-T1: `@` open, `A` close, `B` trigger, `C` reset.
    Uniblitz,
    /// LCUS: frames of four bytes; the shutter hangs on channel 1, normally open.
    Relay,
}

/// Faults of the box.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum OpenShutterFault {
    /// So many bytes are lost.
    BytesLost(u32),
    /// The switch stands on local: every byte is ignored (true) or taken again.
    Local(bool),
    /// Blade stuck or contact welded (true) or freed.
    Stuck(bool),
    /// Opening the port reads as this byte from now on.
    Glitch(u8),
    /// Somebody opens (true) or closes it by hand.
    Hand(bool),
    /// Power goes and comes back: closed.
    Restart,
}

/// A box and its blade.
#[derive(Debug)]
pub struct OpenShutterTwin {
    listener: Listener,
    /// 0 closed, 1 open.
    blade: Track,
    frame: Vec<u8>,
    lost: u32,
    local: bool,
    stuck: bool,
    glitch: Option<u8>,
}

// === impl OpenShutterTwin ===

impl OpenShutterTwin {
    /// A box powered up at `now`, closed.
    pub fn new(listener: Listener, now: Instant) -> OpenShutterTwin {
        let blade = Track::at_rest(0.0, now);
        OpenShutterTwin { listener, blade, frame: Vec::new(), lost: 0, local: false, stuck: false, glitch: None }
    }

    /// True when light passes at `at`.
    pub fn light_passes(&self, at: Instant) -> bool {
        self.blade.position(at) >= 0.5
    }

    /// Lets a fault happen, now or at the next occasion.
    pub fn inject(&mut self, fault: OpenShutterFault, now: Instant) {
        match fault {
            OpenShutterFault::BytesLost(n) => self.lost += n,
            OpenShutterFault::Local(local) => self.local = local,
            OpenShutterFault::Stuck(stuck) => self.stuck = stuck,
            OpenShutterFault::Glitch(byte) => self.glitch = Some(byte),
            OpenShutterFault::Hand(open) => self.blade(open, now),
            OpenShutterFault::Restart => {
                self.frame.clear();
                self.blade(false, now);
            }
        }
    }

    fn blade(&mut self, open: bool, at: Instant) {
        if !self.stuck {
            self.blade.go(at, f64::from(u8::from(open)), BLADE_SPEED, 0.0);
        }
    }

    fn byte(&mut self, byte: u8, now: Instant) {
        if self.lost > 0 {
            self.lost -= 1;
        } else if self.local {
        } else if self.listener == Listener::Relay {
            self.relay(byte, now);
        } else {
            self.uniblitz(byte, now + BYTE);
        }
    }

    /// Plain codes, or `128 + 16 address + code` for box 0.
    fn uniblitz(&mut self, byte: u8, at: Instant) {
        match byte {
            b'@' | 0x80 => self.blade(true, at),
            b'A' | b'C' | 0x81 | 0x83 => self.blade(false, at),
            b'B' | 0x82 => {
                self.blade(true, at);
                if !self.stuck {
                    self.blade.go(at + TRIGGERED, 0.0, BLADE_SPEED, 0.0);
                }
            }
            _ => {}
        }
    }

    /// Frames are found again by their first byte; one with a wrong sum is ignored.
    fn relay(&mut self, byte: u8, now: Instant) {
        if self.frame.is_empty() && byte != FRAME {
            return;
        }
        self.frame.push(byte);
        let &[start, channel, state, sum] = self.frame.as_slice() else { return };
        if sum == start.wrapping_add(channel).wrapping_add(state) {
            if channel == 1 && state <= 1 {
                self.blade(state == 1, now + BYTE);
            }
            self.frame.clear();
        } else {
            let next = self.frame.iter().skip(1).position(|b| *b == FRAME).map_or(self.frame.len(), |p| p + 1);
            self.frame.drain(..next);
        }
    }
}

impl Firmware for OpenShutterTwin {
    fn receive(&mut self, bytes: &[u8], now: Instant) {
        bytes.iter().for_each(|b| self.byte(*b, now));
    }

    fn due(&self) -> Option<Instant> {
        None
    }

    fn take(&mut self, _now: Instant) -> Vec<u8> {
        Vec::new()
    }

    fn connected(&mut self, now: Instant) {
        if let Some(byte) = self.glitch {
            self.byte(byte, now);
        }
    }
}
