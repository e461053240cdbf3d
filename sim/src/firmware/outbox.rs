//! What a twin has said and when it leaves, with the faults that a wire adds to any reply.

use std::collections::VecDeque;
use std::time::Duration;
use tokio::time::Instant;

/// Chunks kept for a host that does not read.
const MAX_CHUNKS: usize = 1024;

/// What can happen to one reply on its way; each is used up by one reply.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum WireFault {
    /// Nothing happens to this reply (to place a fault on a later one).
    Pass,
    /// The reply comes later by this much.
    Late(Duration),
    /// No reply.
    NoReply,
    /// Only the first bytes come.
    Cut(usize),
    /// The byte at this place (modulo the length) is changed by this mask.
    Corrupt(usize, u8),
    /// The byte at this place (modulo the length) is lost.
    Drop(usize),
    /// These bytes come before the reply.
    Junk(Vec<u8>),
    /// The previous reply comes in place of this one.
    Previous,
    /// The reply comes twice.
    Duplicate,
}

/// Bytes that wait for their instant.
#[derive(Debug, Default)]
pub struct Outbox {
    queue: VecDeque<(Instant, Vec<u8>)>,
    faults: VecDeque<WireFault>,
    held: Vec<u8>,
    previous: Vec<u8>,
}

// === impl Outbox ===

impl Outbox {
    /// Lets `fault` happen to the next reply that has none yet.
    pub fn inject(&mut self, fault: WireFault) {
        self.faults.push_back(fault);
    }

    /// True while a fault waits for its reply.
    pub fn faults_wait(&self) -> bool {
        !self.faults.is_empty()
    }

    /// An echo that leaves at once and belongs to the reply that follows. With a fault waiting it is held back, so that
    /// the fault meets the whole answer.
    pub fn echo(&mut self, at: Instant, bytes: &[u8]) {
        self.held.extend_from_slice(bytes);
        if self.faults.is_empty() {
            self.push(at, bytes.to_vec());
        }
    }

    /// The end of a reply, leaving at `at`.
    pub fn reply(&mut self, at: Instant, bytes: &[u8]) {
        let mut whole = std::mem::take(&mut self.held);
        let echoed = whole.len();
        whole.extend_from_slice(bytes);
        let previous = std::mem::replace(&mut self.previous, whole.clone());
        let Some(fault) = self.faults.pop_front() else {
            let rest = whole.split_off(echoed);
            return self.push(at, rest);
        };
        match fault {
            WireFault::Pass => self.push(at, whole),
            WireFault::Late(by) => self.push(at + by, whole),
            WireFault::NoReply => {}
            WireFault::Cut(keep) => {
                whole.truncate(keep);
                self.push(at, whole);
            }
            WireFault::Corrupt(place, mask) => {
                let len = whole.len().max(1);
                if let Some(byte) = whole.get_mut(place % len) {
                    *byte ^= mask;
                }
                self.push(at, whole);
            }
            WireFault::Drop(place) => {
                let len = whole.len().max(1);
                if place % len < whole.len() {
                    whole.remove(place % len);
                }
                self.push(at, whole);
            }
            WireFault::Junk(junk) => self.push(at, [junk, whole].concat()),
            WireFault::Previous => self.push(at, previous),
            WireFault::Duplicate => self.push(at, [whole.clone(), whole].concat()),
        }
    }

    /// Bytes without a request (alerts, power-up noise); no fault meets them.
    pub fn unasked(&mut self, at: Instant, bytes: &[u8]) {
        self.push(at, bytes.to_vec());
    }

    /// Forgets an echo whose command gets no reply.
    pub fn forget_echo(&mut self) {
        self.held.clear();
    }

    /// Throws away everything that has not left.
    pub fn clear(&mut self) {
        self.queue.clear();
        self.held.clear();
    }

    /// When the next bytes leave.
    pub fn due(&self) -> Option<Instant> {
        self.queue.front().map(|(at, _)| *at)
    }

    /// The bytes that have left by `now`.
    pub fn take(&mut self, now: Instant) -> Vec<u8> {
        let mut left = Vec::new();
        while let Some((_, bytes)) = self.queue.pop_front_if(|(at, _)| *at <= now) {
            left.extend(bytes);
        }
        left
    }

    fn push(&mut self, at: Instant, bytes: Vec<u8>) {
        if bytes.is_empty() || self.queue.len() >= MAX_CHUNKS {
            return;
        }
        let place = self.queue.iter().rposition(|(t, _)| *t <= at).map_or(0, |p| p + 1);
        self.queue.insert(place, (at, bytes));
    }
}
