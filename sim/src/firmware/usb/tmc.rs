//! The device's side of USBTMC: messages in, answers out in the parts that reads ask for, class requests.
//!
//! Source: USB Test and Measurement Class 1.0 and its USB488 subclass.

use super::endpoint::{InEndpoint, Taken, UsbFault};
use crate::front::usb::{Answer, SetupPacket};
use std::collections::VecDeque;
use tokio::time::Instant;

/// Endpoints of the meter.
pub const OUT: u8 = 0x02;
/// The IN endpoint.
pub const IN: u8 = 0x82;
/// Packet size at full speed.
pub const PACKET: usize = 64;
/// Bytes of a header.
const HEADER: usize = 12;
/// Most answers that wait.
const MOST_ANSWERS: usize = 64;
/// Longest message taken.
const MOST_MESSAGE: usize = 65_536;
/// Status words.
const SUCCESS: u8 = 0x01;
const PENDING: u8 = 0x02;
const FAILED: u8 = 0x80;
const NOT_IN_PROGRESS: u8 = 0x81;

/// A fault of the frame around an answer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FrameFault {
    /// The tag is that of another read.
    Tag,
    /// The end of the message is not marked.
    NoEnd,
}

/// The message layer.
#[derive(Debug)]
pub struct TmcPort {
    input: InEndpoint,
    message: Vec<u8>,
    answers: VecDeque<(Instant, Vec<u8>)>,
    /// The read that waits: tag, most bytes, character to stop at.
    read: Option<(u8, usize, Option<u8>)>,
    /// Tag of the last read that was answered or waits, and bytes given to it.
    last_read: Option<u8>,
    given: u32,
    out_halted: bool,
    clearing: bool,
    frame_faults: VecDeque<FrameFault>,
    previous: Vec<u8>,
}

/// What a bulk OUT transfer was.
#[derive(Debug, PartialEq, Eq)]
pub enum Received {
    /// A whole message for the instrument.
    Message(Vec<u8>),
    /// A read that finds no answer and no question that makes one.
    Unterminated,
    /// Nothing for the instrument.
    Nothing,
    /// Not understood: the endpoint is halted.
    Halted,
}

// === impl TmcPort ===

impl TmcPort {
    /// An idle port.
    pub fn new() -> TmcPort {
        TmcPort {
            input: InEndpoint::new(PACKET),
            message: Vec::new(),
            answers: VecDeque::new(),
            read: None,
            last_read: None,
            given: 0,
            out_halted: false,
            clearing: false,
            frame_faults: VecDeque::new(),
            previous: Vec::new(),
        }
    }

    /// Lets a fault of the frame meet the next part.
    pub fn inject(&mut self, fault: FrameFault) {
        self.frame_faults.push_back(fault);
    }

    /// An answer that is ready at `at`, with the fault that meets it. False when the device is to restart.
    pub fn answer(&mut self, mut answer: Vec<u8>, at: Instant, fault: UsbFault) -> bool {
        let mut at = at;
        let previous = std::mem::replace(&mut self.previous, answer.clone());
        match fault {
            UsbFault::Pass => {}
            UsbFault::Late(by) => at += by,
            UsbFault::NoReply => return true,
            UsbFault::Cut(keep) => answer.truncate(keep),
            UsbFault::Corrupt(place, mask) => {
                let place = place % answer.len().max(1);
                answer.iter_mut().skip(place).take(1).for_each(|byte| *byte ^= mask);
            }
            UsbFault::Junk(junk) => self.queue(junk, at),
            UsbFault::Previous => answer = previous,
            UsbFault::Duplicate => self.queue(answer.clone(), at),
            UsbFault::Stall => {
                self.input.halt(at);
                return true;
            }
            UsbFault::Babble => {
                self.input.push_packet(vec![0xAA; 4 * PACKET + HEADER * PACKET], at);
                return true;
            }
            UsbFault::Restart => return false,
        }
        self.queue(answer, at);
        true
    }

    fn queue(&mut self, answer: Vec<u8>, at: Instant) {
        if self.answers.len() < MOST_ANSWERS {
            self.answers.push_back((at, answer));
        }
    }

    /// Bytes on the bulk OUT endpoint.
    pub fn receive(&mut self, bytes: &[u8]) -> Received {
        if self.out_halted {
            return Received::Halted;
        }
        let Some((&[id, tag, inverse, _, s0, s1, s2, s3, attributes, stop, _, _], body)) =
            bytes.split_first_chunk::<HEADER>()
        else {
            return self.halt();
        };
        let size = u32::from_le_bytes([s0, s1, s2, s3]) as usize;
        if tag == 0 || tag != !inverse {
            return self.halt();
        }
        match id {
            1 => {
                let Some(data) = body.get(..size) else { return self.halt() };
                // A new message ends a read that waits.
                self.read = None;
                if self.message.len() + size > MOST_MESSAGE {
                    self.message.clear();
                    return self.halt();
                }
                self.message.extend(data);
                if attributes & 1 == 0 {
                    return Received::Nothing;
                }
                Received::Message(std::mem::take(&mut self.message))
            }
            2 => {
                self.read = Some((tag, size, (attributes & 2 != 0).then_some(stop)));
                self.last_read = Some(tag);
                self.given = 0;
                if self.answers.is_empty() { Received::Unterminated } else { Received::Nothing }
            }
            // USB488 trigger: taken, does nothing here.
            128 => Received::Nothing,
            _ => self.halt(),
        }
    }

    fn halt(&mut self) -> Received {
        self.out_halted = true;
        Received::Halted
    }

    /// What the bulk IN endpoint has.
    pub fn give(&mut self, length: usize, now: Instant) -> Answer {
        if self.input.is_empty()
            && let Some(part) = self.part(now)
        {
            self.input.push(&part, true, now);
        }
        match self.input.take(length, now) {
            Taken::Bytes(bytes) => Answer::Data(bytes),
            Taken::Nothing => Answer::Nak,
            Taken::Halted => Answer::Stall,
        }
    }

    /// The next part of the answer for the read that waits.
    fn part(&mut self, now: Instant) -> Option<Vec<u8>> {
        let (tag, most, stop) = self.read?;
        let (at, answer) = self.answers.front_mut()?;
        if *at > now {
            return None;
        }
        let stopped = stop.and_then(|stop| answer.iter().position(|&b| b == stop)).map(|place| place + 1);
        let take = answer.len().min(most).min(stopped.unwrap_or(usize::MAX));
        let data: Vec<u8> = answer.drain(..take).collect();
        let whole = answer.is_empty();
        if whole {
            self.answers.pop_front();
        }
        self.read = None;
        self.given = data.len() as u32;
        let fault = self.frame_faults.pop_front();
        let tag = if fault == Some(FrameFault::Tag) { tag.wrapping_add(1).max(1) } else { tag };
        let end = whole && fault != Some(FrameFault::NoEnd);
        let mut part = vec![2, tag, !tag, 0];
        part.extend((data.len() as u32).to_le_bytes());
        part.extend([u8::from(end), 0, 0, 0]);
        part.extend(data);
        part.resize(part.len().next_multiple_of(4), 0);
        Some(part)
    }

    /// An answer waits for a read.
    pub fn message_available(&self, now: Instant) -> bool {
        self.answers.front().is_some_and(|(at, _)| *at <= now)
    }

    /// When a read that waits gets something.
    pub fn due(&self) -> Option<Instant> {
        let answer = self.read.and_then(|_| self.answers.front()).map(|(at, _)| *at);
        answer.into_iter().chain(self.input.due()).min()
    }

    /// A class request; `status` is the instrument's status byte.
    pub fn control(&mut self, setup: SetupPacket, status: u8, now: Instant) -> Answer {
        let [tag, _] = setup.value.to_le_bytes();
        let answer = match (setup.request_type, setup.request) {
            (0xA2, 1) => vec![NOT_IN_PROGRESS, tag],
            (0xA2, 2) => vec![SUCCESS, 0, 0, 0, 0, 0, 0, 0],
            (0xA2, 3) => self.abort_read(tag, now),
            (0xA2, 4) => {
                let mut answer = vec![SUCCESS, 0, 0, 0];
                answer.extend(self.given.to_le_bytes());
                answer
            }
            (0xA1, 5) => {
                self.clear();
                self.clearing = true;
                vec![SUCCESS]
            }
            (0xA1, 6) => {
                let done = !std::mem::take(&mut self.clearing);
                vec![if done { SUCCESS } else { PENDING }, 0]
            }
            (0xA1, 7) => CAPABILITIES.to_vec(),
            (0xA1, 64 | 160..=162) => vec![SUCCESS],
            (0xA1, 128) => vec![SUCCESS, tag, status],
            _ => return Answer::Stall,
        };
        let mut answer = answer;
        answer.truncate(setup.length.into());
        Answer::Data(answer)
    }

    /// Ends the read with this tag: what is left of it goes, an empty packet ends the transfer.
    fn abort_read(&mut self, tag: u8, now: Instant) -> Vec<u8> {
        let waits = self.read.is_some() || !self.input.is_empty();
        if !waits {
            return vec![FAILED, 0];
        }
        if self.last_read != Some(tag) {
            return vec![NOT_IN_PROGRESS, self.last_read.unwrap_or(0)];
        }
        self.read = None;
        self.input.clear();
        self.input.push_packet(Vec::new(), now);
        vec![SUCCESS, tag]
    }

    /// Everything under way is gone.
    pub fn clear(&mut self) {
        self.input.clear();
        self.message.clear();
        self.answers.clear();
        self.read = None;
        self.out_halted = false;
    }

    /// The host cleared a halt.
    pub fn clear_halt(&mut self, endpoint: u8) {
        match endpoint {
            OUT => self.out_halted = false,
            IN => self.input.clear_halt(),
            _ => {}
        }
    }
}

impl Default for TmcPort {
    fn default() -> TmcPort {
        TmcPort::new()
    }
}

/// USBTMC 1.0 with indicator pulse and stop character; USB488 1.0, 488.2, remote and local, trigger.
const CAPABILITIES: [u8; 24] = [1, 0, 0, 1, 4, 1, 0, 0, 0, 0, 0, 0, 0, 1, 7, 4, 0, 0, 0, 0, 0, 0, 0, 0];
