//! Echo-and-prompt lines of the Thorlabs family (FW102C/FW212C, SC10): request CR in, `echo CR [value CR] > ` out.
//!
//! Source: FW102C/FW212C manual Rev H (command chapter), SC10 manual 8654-D02. The line has no checksum: an answer
//! counts only when its echo is exactly the request, and a value that decides something is asked until two answers agree.

use crate::clock::Clock;
use crate::error::{DeviceError, ErrorKind, Result};
use crate::transport::{Connector, Link};
use std::time::Duration;

/// Limit of a query.
pub(super) const QUERY_LIMIT: Duration = Duration::from_secs(1);
/// Quiet time that ends a drain.
const QUIET: Duration = Duration::from_millis(100);
/// Tries to get the exact answer to an empty line.
const SYNC_TRIES: u32 = 3;
/// Queries for two agreeing answers.
const AGREE_TRIES: u32 = 6;
/// Waits in a row without any answer after which a question is given up: recovery may do more than a driver.
const MOST_SILENCES: u32 = 2;
/// What an empty line is answered with.
const SYNC_ANSWER: &str = "Command error CMD_NOT_DEFINED";

/// A link to one device of the family.
pub(super) struct PromptWire {
    connector: Box<dyn Connector>,
    link: Option<Link>,
    pub(super) clock: Clock,
    pub(super) label: String,
    /// The last exchange has no proven end (lost, cut, garbled or cancelled): synchronise before the next.
    suspect: bool,
    /// Waits in a row in which nothing came.
    silences: u32,
    /// Times that bytes came without being asked for: restarts and noise.
    pub(super) unsolicited: u64,
}

// === impl PromptWire ===

impl PromptWire {
    /// A wire for the device `name`; nothing is opened yet.
    pub(super) fn new(name: &str, connector: Box<dyn Connector>, clock: Clock) -> PromptWire {
        let label = format!("{name} ({})", connector.port());
        PromptWire { connector, link: None, clock, label, suspect: true, silences: 0, unsolicited: 0 }
    }

    pub(super) fn error(&self, kind: ErrorKind, message: impl Into<String>) -> DeviceError {
        DeviceError::new(kind, &self.label, message)
    }

    /// Makes sure that a synchronised link is there, connecting anew when the old one is dead.
    pub(super) async fn ensure(&mut self) -> Result<()> {
        (self.unsolicited, self.silences) = (0, 0);
        if self.link.is_some() && self.synchronise().await.is_ok() {
            return Ok(());
        }
        let connected = self.connector.connect().await;
        self.link = Some(connected.map_err(|e| self.error(e.kind, e.message))?);
        self.silences = 0;
        self.synchronise_until(SYNC_TRIES).await
    }

    /// Drains until quiet and sends the empty line until its exact answer comes, at most three times; two in silence are enough.
    pub(super) async fn synchronise(&mut self) -> Result<()> {
        self.synchronise_until(MOST_SILENCES).await
    }

    async fn synchronise_until(&mut self, most_silences: u32) -> Result<()> {
        self.suspect = true;
        let (mut last, mut tries) = (String::from("nothing"), 0);
        for _ in 0..SYNC_TRIES {
            tries += 1;
            let text = match self.synchronise_once().await {
                Ok(text) => text,
                Err(error) => return Err(self.fail(error)),
            };
            if let Some(text) = text {
                if text.trim_matches(is_filler) == SYNC_ANSWER {
                    self.suspect = false;
                    return Ok(());
                }
                last = format!("{text:?}");
            }
            if self.silences >= most_silences {
                break;
            }
        }
        let what = format!(
            "no exact answer to an empty line in {tries} tries (last: {last}); check power, cable, baud rate and that the right device is connected"
        );
        Err(self.error(if last == "nothing" { ErrorKind::Timeout } else { ErrorKind::Garbled }, what))
    }

    async fn synchronise_once(&mut self) -> Result<Option<String>> {
        let deadline_from = |clock: &Clock| clock.now() + QUERY_LIMIT;
        let Some(link) = self.link.as_mut() else { return Err(not_open(&self.label)) };
        link.drain(QUIET).await?;
        link.send(b"\r").await?;
        let text = link.prompt(deadline_from(&self.clock)).await?;
        let late = link.unsolicited().await?;
        self.silences = if text.is_some() || late > 0 { 0 } else { self.silences + 1 };
        Ok(text.filter(|_| late == 0).map(|bytes| String::from_utf8_lossy(&bytes).into_owned()))
    }

    /// Sends `request` once and gives the text between echo and prompt. `Refused` carries the device's own error.
    /// After any failure the device may or may not have acted.
    pub(super) async fn exchange(&mut self, request: &str, limit: Duration) -> Result<String> {
        if !self.suspect {
            let early = match self.link.as_mut() {
                Some(link) => link.unsolicited().await,
                None => Err(not_open(&self.label)),
            };
            if early.map_err(|e| self.fail(e))? > 0 {
                self.unsolicited += 1;
                self.suspect = true;
            }
        }
        if self.suspect {
            self.synchronise().await?;
        }
        self.suspect = true;
        let Some(link) = self.link.as_mut() else { return Err(not_open(&self.label)) };
        let sent = link.send(format!("{request}\r").as_bytes()).await;
        let read = match sent {
            Ok(()) => link.prompt(self.clock.now() + limit).await,
            Err(error) => Err(error),
        };
        let Some(raw) = read.map_err(|e| self.fail(e))? else {
            self.silences += 1;
            let what = format!("no ready prompt within {} s after `{request}`", limit.as_secs_f64());
            return Err(self.error(ErrorKind::Timeout, what));
        };
        self.silences = 0;
        let text = String::from_utf8_lossy(&raw).into_owned();
        let Some(body) = body(&text, request) else {
            let what = format!("the answer {text:?} does not begin with the echo of `{request}`");
            return Err(self.error(ErrorKind::Garbled, what));
        };
        if text.trim_start_matches([' ', '\0']).contains('\0') {
            let what =
                format!("a NUL came with the answer to `{request}`: the device restarted, or the line is disturbed");
            return Err(self.error(ErrorKind::Garbled, what));
        }
        if body == SYNC_ANSWER && !request.is_empty() {
            let what = format!(
                "the device did not understand `{request}`: other bytes reached it than were sent, or its firmware lacks the command"
            );
            return Err(self.error(ErrorKind::Garbled, what));
        }
        self.suspect = false;
        match body.strip_prefix("Command error ") {
            Some(why) => Err(self.error(ErrorKind::Refused, format!("the device rejected `{request}`: {why}"))),
            None => Ok(body.to_owned()),
        }
    }

    /// The value of a query, asked until two answers in a row agree; answers that are lost or garbled are asked again.
    pub(super) async fn value(&mut self, query: &str) -> Result<String> {
        let mut last: Option<String> = None;
        let mut failure = None;
        for _ in 0..AGREE_TRIES {
            match self.exchange(query, QUERY_LIMIT).await {
                Ok(value) if last.as_ref() == Some(&value) => return Ok(value),
                Ok(value) => last = Some(value),
                Err(error) if self.silences >= MOST_SILENCES => return Err(error),
                Err(error) if matches!(error.kind, ErrorKind::Timeout | ErrorKind::Garbled) => failure = Some(error),
                Err(error) => return Err(error),
            }
        }
        Err(failure.unwrap_or_else(|| {
            self.error(ErrorKind::Garbled, format!("no two answers to `{query}` agree; check cable and earthing"))
        }))
    }

    /// The value of a query as a small number.
    pub(super) async fn number(&mut self, query: &str) -> Result<u8> {
        let text = self.value(query).await?;
        text.parse().map_err(|_| self.error(ErrorKind::Garbled, format!("`{query}` gave {text:?}, a number is needed")))
    }

    /// Writes a setting when it differs and proves it; safe to repeat.
    pub(super) async fn write(&mut self, name: &str, value: u8) -> Result<()> {
        for _ in 0..SYNC_TRIES {
            if self.number(&format!("{name}?")).await? == value {
                return Ok(());
            }
            match self.exchange(&format!("{name}={value}"), QUERY_LIMIT).await {
                Ok(_) => {}
                Err(error) if matches!(error.kind, ErrorKind::Timeout | ErrorKind::Garbled) => {}
                Err(error) => return Err(error),
            }
        }
        if self.number(&format!("{name}?")).await? == value {
            return Ok(());
        }
        Err(self.error(ErrorKind::Broken, format!("the device does not keep {name}={value}")))
    }

    /// Notes a lost link and names the device in the error.
    fn fail(&mut self, error: DeviceError) -> DeviceError {
        if error.kind == ErrorKind::Lost {
            self.link = None;
        }
        self.error(error.kind, error.message)
    }
}

/// Characters that carry nothing: line ends, the space of an earlier prompt, NUL after power-up.
fn is_filler(c: char) -> bool {
    matches!(c, '\r' | '\n' | ' ' | '\0')
}

/// The text between the echo of `request` and the prompt; `None` when the echo is not exact or the text has lines.
fn body<'a>(text: &'a str, request: &str) -> Option<&'a str> {
    let rest = text.trim_start_matches([' ', '\0']).strip_prefix(request)?.strip_prefix('\r')?;
    let body = rest.trim_matches(is_filler);
    (!body.contains(['\r', '\n', '\0', '\u{fffd}'])).then_some(body)
}

fn not_open(label: &str) -> DeviceError {
    DeviceError::new(ErrorKind::Lost, label, "the device is not connected; open it first")
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used)]
    use super::*;

    #[test]
    fn replies_are_the_worked_exchange() {
        assert_eq!(body("pos?\r3\r", "pos?"), Some("3"));
        assert_eq!(body("pos=5\r", "pos=5"), Some(""));
        assert_eq!(body("pos=13\rCommand error CMD_ARG_INVALID\r", "pos=13"), Some("Command error CMD_ARG_INVALID"));
        assert_eq!(body("pos=13\rCommand error CMD_ARG_INVALID\n", "pos=13"), Some("Command error CMD_ARG_INVALID"));
        assert_eq!(body(" ens?\r0\r", "ens?"), Some("0"));
        assert_eq!(body("\0\0ens\r", "ens"), Some(""));
    }

    #[test]
    fn only_the_exact_echo_counts() {
        assert_eq!(body("pcount?\r12\r", "pos?"), None);
        assert_eq!(body("3\r", "pos?"), None);
        assert_eq!(body("pos=3\r", "pos=5"), None);
        assert_eq!(body("ens?\r1\r", "ens"), None);
        assert_eq!(body("pos?\r3\rpos?\r3\r", "pos?"), None);
        assert_eq!(body("", "pos?"), None);
    }
}
