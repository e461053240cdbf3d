//! Probe and commit: host and camera agree on format, interval and payload size (UVC 1.0, 4.3.1.1; 26 bytes). Pure.

use super::controls::{GET_CUR, GET_DEF, GET_INFO, GET_LEN, GET_MAX, GET_MIN, SET_CUR};
use super::descriptors::{LONGEST_INTERVAL, SHORTEST_INTERVAL};
use super::mode::Mode;
use crate::front::usb::{Answer, SetupPacket};

/// Bytes of one payload with its header; Linux takes it as the length of a transfer.
pub const PAYLOAD: usize = 16_384;
/// Bytes of the negotiated block in UVC 1.0.
const BLOCK: usize = 26;

/// What was agreed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Agreement {
    /// Index into the camera's modes.
    pub mode: usize,
    /// Frame interval in 100 ns.
    pub interval: u32,
}

/// Both sides' last words.
#[derive(Debug, Clone)]
pub struct Negotiation {
    modes: Vec<Mode>,
    probe: Agreement,
}

/// What a request to the streaming interface comes to.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Outcome {
    /// An answer only.
    Answered(Answer),
    /// The host commits: pictures begin.
    Committed(Agreement),
}

// === impl Negotiation ===

impl Negotiation {
    /// Nothing agreed: the first mode at its shortest interval.
    pub fn new(modes: Vec<Mode>) -> Negotiation {
        Negotiation { modes, probe: Agreement { mode: 0, interval: SHORTEST_INTERVAL } }
    }

    /// Answers a class request to the streaming interface.
    pub fn request(&mut self, setup: SetupPacket, bytes: &[u8]) -> Outcome {
        let commit = match setup.value >> 8 {
            1 => false,
            2 => true,
            _ => return Outcome::Answered(Answer::Stall),
        };
        Outcome::Answered(match setup.request {
            SET_CUR => match self.read(bytes) {
                Some(agreed) if commit => {
                    self.probe = agreed;
                    return Outcome::Committed(agreed);
                }
                Some(probe) => {
                    self.probe = probe;
                    Answer::Data(Vec::new())
                }
                None => Answer::Stall,
            },
            GET_CUR => Answer::Data(self.block(self.probe)),
            GET_MIN | GET_DEF => Answer::Data(self.block(Agreement { interval: SHORTEST_INTERVAL, ..self.probe })),
            GET_MAX => Answer::Data(self.block(Agreement { interval: LONGEST_INTERVAL, ..self.probe })),
            GET_LEN => Answer::Data((BLOCK as u16).to_le_bytes().to_vec()),
            GET_INFO => Answer::Data(vec![3]),
            _ => Answer::Stall,
        })
    }

    /// What the host asks for, brought into the camera's limits; `None` for a block or format that does not exist.
    fn read(&self, bytes: &[u8]) -> Option<Agreement> {
        let format = usize::from(*bytes.get(2)?).max(1);
        let mode = self.modes.get(format - 1).map(|_| format - 1)?;
        let interval = u32::from_le_bytes(bytes.get(4..8)?.try_into().ok()?);
        let interval = interval.clamp(SHORTEST_INTERVAL, LONGEST_INTERVAL);
        (bytes.len() >= BLOCK).then_some(Agreement { mode, interval })
    }

    fn block(&self, agreement: Agreement) -> Vec<u8> {
        let mut out = vec![0; BLOCK];
        let size = self.modes.get(agreement.mode).map_or(0, |m| m.bytes() as u32);
        out.splice(2..4, [agreement.mode as u8 + 1, 1]);
        out.splice(4..8, agreement.interval.to_le_bytes());
        out.splice(18..22, size.to_le_bytes());
        out.splice(22..26, (PAYLOAD as u32).to_le_bytes());
        out
    }
}
