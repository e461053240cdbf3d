//! The device's side of the echo-and-prompt lines that Thorlabs wheel and shutter share.

use super::outbox::{Outbox, WireFault};
use std::time::Duration;
use tokio::time::Instant;

/// Characters a request may have; more are echoed and forgotten.
const MAX_REQUEST: usize = 64;

/// Echoes byte by byte and gathers requests.
#[derive(Debug)]
pub(super) struct PromptPort {
    outbox: Outbox,
    line: Vec<u8>,
    delay: Duration,
    /// The next request is not echoed.
    pub mute_echo: bool,
}

// === impl PromptPort ===

impl PromptPort {
    /// A port that answers after `delay`.
    pub fn new(delay: Duration) -> PromptPort {
        PromptPort { outbox: Outbox::default(), line: Vec::new(), delay, mute_echo: false }
    }

    pub fn inject(&mut self, fault: WireFault) {
        self.outbox.inject(fault);
    }

    /// True while a fault waits for its occasion.
    pub fn faults_wait(&self) -> bool {
        self.mute_echo || self.outbox.faults_wait()
    }

    /// Takes a byte; gives the request when it was the CR.
    pub fn byte(&mut self, byte: u8, now: Instant) -> Option<String> {
        if !self.mute_echo {
            self.outbox.echo(now, &[byte]);
        }
        if byte == b'\r' {
            self.mute_echo = false;
            let line = std::mem::take(&mut self.line);
            return Some(String::from_utf8_lossy(&line).into_owned());
        }
        if self.line.len() < MAX_REQUEST {
            self.line.push(byte);
        }
        None
    }

    /// An arrow key (ESC `[` `A` or `B`) has just come: true for up.
    pub fn arrow(&mut self) -> Option<bool> {
        let up = match self.line.last_chunk::<3>()? {
            b"\x1b[A" => true,
            b"\x1b[B" => false,
            _ => return None,
        };
        self.line.clear();
        Some(up)
    }

    /// Value CR and prompt.
    pub fn value(&mut self, value: impl std::fmt::Display, now: Instant) {
        self.outbox.reply(now + self.delay, format!("{value}\r> ").as_bytes());
    }

    /// The prompt alone, leaving at `at`.
    pub fn done(&mut self, at: Instant) {
        self.outbox.reply(at + self.delay, b"> ");
    }

    /// The device's own error and prompt.
    pub fn error(&mut self, name: &str, now: Instant) {
        self.value(format_args!("Command error {name}"), now);
    }

    /// No answer at all, beyond the echo that has left.
    pub fn silence(&mut self) {
        self.outbox.forget_echo();
    }

    /// Bytes without a request.
    pub fn unasked(&mut self, bytes: &[u8], now: Instant) {
        self.outbox.unasked(now, bytes);
    }

    /// Throws away half a request and all that has not left.
    pub fn reset(&mut self) {
        self.outbox.clear();
        self.line.clear();
        self.mute_echo = false;
    }

    pub fn due(&self) -> Option<Instant> {
        self.outbox.due()
    }

    pub fn take(&mut self, now: Instant) -> Vec<u8> {
        self.outbox.take(now)
    }
}
