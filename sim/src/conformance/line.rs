//! The line between a driver and its twin, with a hand on it: it counts, falls silent, carries junk, and lets the power
//! fail at a request.

use crate::firmware::usb::UsbFault;
use crate::firmware::{Firmware, WireFault};
use crate::front::usb::{Answer, Descriptors, SetupPacket, UsbTwin};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use tokio::time::Instant;

/// The hand on a line; clones share it.
#[derive(Debug, Clone, Default)]
pub struct Line(Arc<Mutex<State>>);

#[derive(Debug, Default)]
struct State {
    /// Requests that reached the device.
    requests: u64,
    /// Bytes (or packets) that may still come from the device; `None` without end.
    left: Option<usize>,
    /// What comes once when the port is opened next.
    junk: Vec<u8>,
    /// The power fails at this request from now, counted from 0.
    restart_at: Option<u64>,
    /// The next request is lost.
    lose: bool,
}

/// A twin behind a watched line; clones are the same twin, so that it can stand behind several ports.
pub struct Watched<T> {
    twin: Arc<Mutex<T>>,
    line: Line,
    restart: fn(&mut T, Instant),
    waiting: Vec<u8>,
}

// === impl Line ===

impl Line {
    fn state(&self) -> MutexGuard<'_, State> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Requests that reached the device since it was made.
    pub fn requests(&self) -> u64 {
        self.state().requests
    }

    /// Only so many more bytes (packets on USB) come from the device; `None`: all.
    pub fn silence_after(&self, left: Option<usize>) {
        self.state().left = left;
    }

    /// These bytes come when the port is opened next.
    pub fn junk(&self, bytes: &[u8]) {
        self.state().junk = bytes.to_vec();
    }

    /// The power fails at this request from now, counted from 0; the request gets no answer.
    pub fn restart_at(&self, request: Option<u64>) {
        self.state().restart_at = request;
    }

    /// The next request is lost on its way; false when one is about to be lost already.
    pub fn lose_request(&self) -> bool {
        !std::mem::replace(&mut self.state().lose, true)
    }

    /// True when this request is lost on its way.
    fn loses(&self) -> bool {
        std::mem::take(&mut self.state().lose)
    }

    /// Counts a request; true when the power fails at it.
    fn request(&self) -> bool {
        let mut state = self.state();
        state.requests += 1;
        match state.restart_at {
            Some(0) => {
                state.restart_at = None;
                true
            }
            Some(n) => {
                state.restart_at = Some(n - 1);
                false
            }
            None => false,
        }
    }

    /// How many of `wanted` bytes may come.
    fn let_through(&self, wanted: usize) -> usize {
        match &mut self.state().left {
            Some(left) => {
                let through = wanted.min(*left);
                *left -= through;
                through
            }
            None => wanted,
        }
    }

    fn silent(&self) -> bool {
        self.state().left == Some(0)
    }
}

// === impl Watched ===

impl<T> Clone for Watched<T> {
    fn clone(&self) -> Watched<T> {
        let (twin, line) = (Arc::clone(&self.twin), self.line.clone());
        Watched { twin, line, restart: self.restart, waiting: Vec::new() }
    }
}

impl<T> Watched<T> {
    /// A watched twin; `restart` lets its power fail.
    pub fn new(twin: T, restart: fn(&mut T, Instant)) -> Watched<T> {
        Watched { twin: Arc::new(Mutex::new(twin)), line: Line::default(), restart, waiting: Vec::new() }
    }

    /// The hand on the line.
    pub fn line(&self) -> &Line {
        &self.line
    }

    /// The twin.
    pub fn twin(&self) -> MutexGuard<'_, T> {
        self.twin.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl<T: Firmware> Firmware for Watched<T> {
    fn receive(&mut self, bytes: &[u8], now: Instant) {
        if self.line.request() {
            return (self.restart)(&mut self.twin(), now);
        }
        if !self.line.loses() {
            self.twin().receive(bytes, now);
        }
    }

    fn due(&self) -> Option<Instant> {
        self.twin().due()
    }

    fn take(&mut self, now: Instant) -> Vec<u8> {
        let mut bytes = std::mem::take(&mut self.waiting);
        bytes.extend(self.twin().take(now));
        bytes.truncate(self.line.let_through(bytes.len()));
        bytes
    }

    fn connected(&mut self, now: Instant) {
        self.twin().connected(now);
        self.waiting = std::mem::take(&mut self.line.state().junk);
    }
}

impl<T: UsbTwin> UsbTwin for Watched<T> {
    fn descriptors(&self) -> Descriptors {
        self.twin().descriptors()
    }

    fn control(&mut self, setup: SetupPacket, bytes: &[u8], now: Instant) -> Answer {
        if self.line.silent() {
            return Answer::Nak;
        }
        self.twin().control(setup, bytes, now)
    }

    fn bulk_out(&mut self, endpoint: u8, bytes: &[u8], now: Instant) -> Answer {
        if self.line.request() {
            (self.restart)(&mut self.twin(), now);
            return Answer::Nak;
        }
        self.twin().bulk_out(endpoint, bytes, now)
    }

    fn bulk_in(&mut self, endpoint: u8, length: usize, now: Instant) -> Answer {
        if self.line.silent() {
            return Answer::Nak;
        }
        let answer = self.twin().bulk_in(endpoint, length, now);
        if matches!(answer, Answer::Data(_)) {
            self.line.let_through(1);
        }
        answer
    }

    fn clear_halt(&mut self, endpoint: u8, now: Instant) {
        self.twin().clear_halt(endpoint, now);
    }

    fn reset(&mut self, now: Instant) {
        self.twin().reset(now);
    }

    fn due(&self) -> Option<Instant> {
        if self.line.silent() { None } else { self.twin().due() }
    }

    fn left_bus(&mut self) -> bool {
        self.twin().left_bus()
    }
}

/// The fault of a USB answer that comes nearest to that of a serial one.
pub fn on_usb(fault: WireFault) -> UsbFault {
    match fault {
        WireFault::Pass => UsbFault::Pass,
        WireFault::Late(by) => UsbFault::Late(by),
        WireFault::NoReply => UsbFault::NoReply,
        WireFault::Cut(keep) => UsbFault::Cut(keep),
        WireFault::Corrupt(place, mask) => UsbFault::Corrupt(place, mask),
        // The bus loses no single byte: an endpoint halts, or a packet is too long.
        WireFault::Drop(place) if place % 2 == 0 => UsbFault::Stall,
        WireFault::Drop(_) => UsbFault::Babble,
        WireFault::Junk(bytes) => UsbFault::Junk(bytes),
        WireFault::Previous => UsbFault::Previous,
        WireFault::Duplicate => UsbFault::Duplicate,
    }
}
