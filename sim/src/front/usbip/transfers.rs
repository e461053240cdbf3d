//! Transfers of one imported device: which wait, in which order they are tried, how they end. No I/O.

use super::standard::{Sorted, Standard};
use super::wire::{self, Command, Urb};
use crate::front::usb::{Answer, UsbTwin};
use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::time::Instant;

/// How long an unlink waits for a transfer that is still on its way.
const ON_ITS_WAY: Duration = Duration::from_secs(1);

/// Transfers that may wait for one device.
pub const MOST_WAITING: usize = 128;

/// A twin that its owner and the front share.
pub type SharedTwin = Arc<Mutex<dyn UsbTwin>>;

/// What happened to the transfers of a device since it was imported.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Tally {
    /// Ended with success.
    pub done: u64,
    /// Ended because the endpoint was halted or the request unknown.
    pub stalled: u64,
    /// Taken back by the host.
    pub unlinked: u64,
    /// Refused because too many waited, or of a kind that is not carried.
    pub refused: u64,
}

/// The transfers of one device.
pub struct Transfers {
    twin: SharedTwin,
    standard: Standard,
    waiting: VecDeque<Urb>,
    /// Number of the newest transfer that came.
    newest: u32,
    early: Vec<EarlyUnlink>,
    tally: Tally,
}

/// An unlink that overtook its transfer. Linux sends them from two queues (`vhci_tx_loop`), and drops the connection
/// when a transfer ends that it has given up.
struct EarlyUnlink {
    seqnum: u32,
    victim: u32,
    until: Instant,
}

/// How a transfer ended.
struct End {
    status: i32,
    moved: usize,
    bytes: Vec<u8>,
}

fn lock(twin: &SharedTwin) -> MutexGuard<'_, dyn UsbTwin + 'static> {
    twin.lock().unwrap_or_else(PoisonError::into_inner)
}

// === impl Transfers ===

impl Transfers {
    /// A device that a host has just imported.
    pub fn new(twin: SharedTwin) -> Transfers {
        let descriptors = lock(&twin).descriptors();
        Transfers {
            twin,
            standard: Standard::new(descriptors),
            waiting: VecDeque::new(),
            newest: 0,
            early: Vec::new(),
            tally: Tally::default(),
        }
    }

    /// What happened so far.
    pub fn tally(&self) -> Tally {
        self.tally
    }

    /// True while a transfer waits for the twin.
    pub fn waits(&self) -> bool {
        !self.waiting.is_empty() || !self.early.is_empty()
    }

    /// When the twin may have something for a waiting transfer.
    pub fn due(&self) -> Option<Instant> {
        if self.waits() { lock(&self.twin).due() } else { None }
    }

    /// Takes a command; an answer that needs no twin is appended to `out`.
    pub fn take(&mut self, command: Command, now: Instant, out: &mut Vec<u8>) {
        match command {
            Command::Unlink { seqnum, victim } => self.unlink(seqnum, victim, now, out),
            Command::Submit(urb) => self.submit(urb, out),
        }
    }

    fn unlink(&mut self, seqnum: u32, victim: u32, now: Instant, out: &mut Vec<u8>) {
        if let Some(at) = self.waiting.iter().position(|urb| urb.seqnum == victim) {
            self.waiting.remove(at);
            self.tally.unlinked += 1;
            wire::put_unlinked(out, seqnum, true);
        } else if victim.wrapping_sub(self.newest) as i32 > 0 && self.early.len() < MOST_WAITING {
            self.early.push(EarlyUnlink { seqnum, victim, until: now + ON_ITS_WAY });
        } else {
            wire::put_unlinked(out, seqnum, false);
        }
    }

    fn submit(&mut self, urb: Urb, out: &mut Vec<u8>) {
        self.newest = urb.seqnum;
        if let Some(at) = self.early.iter().position(|e| e.victim == urb.seqnum) {
            self.tally.unlinked += 1;
            wire::put_unlinked(out, self.early.swap_remove(at).seqnum, true);
        } else if urb.isochronous {
            self.tally.refused += 1;
            wire::put_submitted(out, urb.seqnum, wire::UNSUPPORTED, 0, &[]);
        } else if self.waiting.len() >= MOST_WAITING {
            self.tally.refused += 1;
            wire::put_submitted(out, urb.seqnum, wire::CROWDED, 0, &[]);
        } else {
            self.waiting.push_back(urb);
        }
    }

    /// Tries all waiting transfers, each endpoint in order, and appends the answers of those that end.
    pub fn pump(&mut self, now: Instant, out: &mut Vec<u8>) {
        for late in self.early.extract_if(.., |e| e.until <= now) {
            wire::put_unlinked(out, late.seqnum, false);
        }
        let mut progress = true;
        while progress {
            progress = false;
            let mut busy = [false; 256];
            for urb in std::mem::take(&mut self.waiting) {
                // Both directions of endpoint 0 are one pipe.
                let pipe = if urb.endpoint & 0x0f == 0 { 0 } else { urb.endpoint };
                let blocked = &mut busy[usize::from(pipe)];
                let end = if *blocked { None } else { self.attempt(&urb, now) };
                match end {
                    Some(end) => {
                        progress = true;
                        wire::put_submitted(out, urb.seqnum, end.status, end.moved, &end.bytes);
                    }
                    None => {
                        *blocked = true;
                        self.waiting.push_back(urb);
                    }
                }
            }
        }
    }

    /// One attempt; `None` while the device is not ready.
    fn attempt(&mut self, urb: &Urb, now: Instant) -> Option<End> {
        let input =
            if urb.endpoint & 0x0f == 0 { urb.setup.request_type & 0x80 != 0 } else { urb.endpoint & 0x80 != 0 };
        let answer = if urb.endpoint & 0x0f == 0 {
            self.control(urb, now)
        } else if self.standard.is_halted(urb.endpoint) {
            Answer::Stall
        } else if input {
            lock(&self.twin).bulk_in(urb.endpoint, urb.length, now)
        } else {
            lock(&self.twin).bulk_out(urb.endpoint, &urb.bytes, now)
        };
        match answer {
            Answer::Nak => None,
            Answer::Stall => {
                self.standard.halt(urb.endpoint);
                self.tally.stalled += 1;
                Some(End { status: wire::STALLED, moved: 0, bytes: Vec::new() })
            }
            Answer::Data(_) if !input => {
                self.tally.done += 1;
                Some(End { status: 0, moved: urb.bytes.len(), bytes: Vec::new() })
            }
            Answer::Data(mut bytes) => {
                let status = if bytes.len() > urb.length { wire::BABBLE } else { 0 };
                bytes.truncate(urb.length);
                self.tally.done += u64::from(status == 0);
                Some(End { status, moved: bytes.len(), bytes })
            }
        }
    }

    fn control(&mut self, urb: &Urb, now: Instant) -> Answer {
        let answer = match self.standard.request(urb.setup) {
            Sorted::Answered(answer) => answer,
            Sorted::Cleared(endpoint) => {
                lock(&self.twin).clear_halt(endpoint, now);
                Answer::Data(Vec::new())
            }
            Sorted::Configured => {
                lock(&self.twin).reset(now);
                Answer::Data(Vec::new())
            }
            Sorted::ForTwin => lock(&self.twin).control(urb.setup, &urb.bytes, now),
        };
        match answer {
            // A control read gives what fits wLength; that is no babble.
            Answer::Data(mut bytes) => {
                bytes.truncate(usize::from(urb.setup.length));
                Answer::Data(bytes)
            }
            other => other,
        }
    }
}
