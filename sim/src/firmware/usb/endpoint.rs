//! Packets that wait in an IN endpoint, and what can happen to an answer on its way there.

use std::collections::VecDeque;
use std::time::Duration;
use tokio::time::Instant;

/// Packets kept for a host that does not read.
const MOST_PACKETS: usize = 4096;

/// What can happen to one answer; each is used up by one answer.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum UsbFault {
    /// Nothing happens to this answer (to place a fault on a later one).
    Pass,
    /// It comes later by this much.
    Late(Duration),
    /// It does not come.
    NoReply,
    /// Only the first bytes come.
    Cut(usize),
    /// The byte at this place (modulo the length) is changed by this mask. Of a spectrum only the last byte is: the bus
    /// guards what it carries with a checksum, so what a firmware garbles is the frame.
    Corrupt(usize, u8),
    /// These bytes come before it, as a packet of their own.
    Junk(Vec<u8>),
    /// The previous answer comes in its place.
    Previous,
    /// It comes twice.
    Duplicate,
    /// The endpoint halts instead.
    Stall,
    /// More bytes come than a packet may have.
    Babble,
    /// The device restarts instead of answering: it leaves the bus and comes back with its power-up settings.
    Restart,
}

/// An IN endpoint: packets with the instants they are ready at, in order.
#[derive(Debug, Default)]
pub struct InEndpoint {
    packet: usize,
    queue: VecDeque<(Instant, Vec<u8>)>,
    /// The next transfer finds the endpoint halted.
    stall: Option<Instant>,
    /// The last transfer found nothing: somebody may wait.
    starved: bool,
}

/// What an IN endpoint has for a transfer.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Taken {
    /// Bytes up to a short packet, a full buffer or the last packet that is ready. More than asked for is an overflow.
    Bytes(Vec<u8>),
    /// Nothing yet.
    Nothing,
    /// Halted.
    Halted,
}

// === impl InEndpoint ===

impl InEndpoint {
    /// An empty endpoint with packets of this size.
    pub fn new(packet: usize) -> InEndpoint {
        InEndpoint { packet: packet.max(1), ..InEndpoint::default() }
    }

    /// Puts a message in, as full packets and a short one. With `end`, a message that fills its last packet is ended by an
    /// empty one.
    pub fn push(&mut self, bytes: &[u8], end: bool, at: Instant) {
        let mut packets: Vec<&[u8]> = bytes.chunks(self.packet).collect();
        if end && bytes.len().is_multiple_of(self.packet) {
            packets.push(&[]);
        }
        for packet in packets {
            self.push_packet(packet.to_vec(), at);
        }
    }

    /// Puts one packet in, whatever its size.
    pub fn push_packet(&mut self, packet: Vec<u8>, at: Instant) {
        if self.queue.len() < MOST_PACKETS {
            self.queue.push_back((at, packet));
        }
    }

    /// Halts the endpoint at `at`.
    pub fn halt(&mut self, at: Instant) {
        self.stall = Some(at);
    }

    /// What a transfer of `length` bytes gets at `now`.
    pub fn take(&mut self, length: usize, now: Instant) -> Taken {
        if self.stall.is_some_and(|at| at <= now) {
            return Taken::Halted;
        }
        let mut bytes = Vec::new();
        let mut any = false;
        while bytes.len() < length || !any {
            let Some((_, packet)) = self.queue.pop_front_if(|(at, _)| *at <= now) else { break };
            any = true;
            let short = packet.len() < self.packet;
            bytes.extend(packet);
            if short {
                break;
            }
        }
        self.starved = !any;
        if any { Taken::Bytes(bytes) } else { Taken::Nothing }
    }

    /// Nothing waits, now or later.
    pub fn is_empty(&self) -> bool {
        self.queue.is_empty()
    }

    /// When the next packet is ready, or the halt begins; `None` while no transfer asked in vain.
    pub fn due(&self) -> Option<Instant> {
        if !self.starved {
            return None;
        }
        let packet = self.queue.front().map(|(at, _)| *at);
        packet.into_iter().chain(self.stall).min()
    }

    /// The halt is over.
    pub fn clear_halt(&mut self) {
        self.stall = None;
    }

    /// Throws everything away.
    pub fn clear(&mut self) {
        self.queue.clear();
        self.stall = None;
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used)]
    use super::*;

    #[tokio::test(start_paused = true)]
    async fn a_transfer_ends_with_a_short_packet_or_a_full_buffer() {
        let now = Instant::now();
        let mut end = InEndpoint::new(4);
        end.push(b"abcdefghij", true, now);
        end.push(b"klmn", true, now);
        assert_eq!(end.take(4, now), Taken::Bytes(b"abcd".to_vec()));
        assert_eq!(end.take(64, now), Taken::Bytes(b"efghij".to_vec()));
        assert_eq!(end.take(64, now), Taken::Bytes(b"klmn".to_vec()));
        assert_eq!(end.take(64, now), Taken::Nothing);
        end.push(b"opqr", true, now);
        assert_eq!(end.take(4, now), Taken::Bytes(b"opqr".to_vec()));
        assert_eq!(end.take(4, now), Taken::Bytes(Vec::new()));
        end.push(b"stu", false, now);
        assert_eq!(end.take(2, now), Taken::Bytes(b"stu".to_vec()), "a packet that does not fit is an overflow");
        let later = now + Duration::from_millis(5);
        end.push(b"v", false, later);
        assert_eq!(end.due(), None);
        assert_eq!((end.take(4, now), end.due()), (Taken::Nothing, Some(later)));
        end.halt(now);
        assert_eq!(end.take(4, later), Taken::Halted);
        end.clear_halt();
        assert_eq!(end.take(4, later), Taken::Bytes(b"v".to_vec()));
    }
}
