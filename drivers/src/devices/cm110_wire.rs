//! Bytes of the Spectral Products CM110: what may be sent, what comes back, and a link that is resynchronised by ECHO.
//!
//! Source: CM110/112 manual (command chapter), protocol sheet `spectralproducts-cm110`. A reply is read by its length,
//! never up to 24: a value byte may be 24 itself. There is no checksum: a value counts when two answers in a row agree.

use crate::clock::Clock;
use crate::error::{DeviceError, ErrorKind, Result};
use crate::transport::{Connector, Link};
use std::time::Duration;
use tokio::time::Instant;

/// End of command.
pub const END: u8 = 24;
/// The harmless no-op and its whole answer.
pub const ECHO: u8 = 27;
/// Units code of an angstrom.
pub const ANGSTROM: u8 = 2;
/// Time for an echo.
const ECHO_LIMIT: Duration = Duration::from_millis(300);
/// Time for a status byte or the answer to a query.
const REPLY_LIMIT: Duration = Duration::from_millis(500);
/// Time for the 24 after a rejection; its absence is accepted (assumed: no source tells whether it comes).
const REJECTION_END: Duration = Duration::from_millis(200);
/// Quiet time that ends a drain.
const QUIET: Duration = Duration::from_millis(100);
/// No command takes more than four parameters, so one echo in six is answered even in the middle of a command.
const SYNC_TRIES: u32 = 6;
/// Queries for two agreeing answers.
const AGREE_TRIES: u32 = 6;
/// Longest wait for a box that said something but not its echo: half a command that was left behind may have become a
/// whole one, and it is deaf while it moves (the whole range at the slowest slew).
const STRAY_MOVE: Duration = Duration::from_secs(60);
/// Pause between echoes while the drive moves.
const MOVING_POLL: Duration = Duration::from_secs(1);

/// All that this driver can say. ZERO, INC, DEC, CALIBRATE, RESET, SELECT and SCAN have no way into the encoder.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Request {
    /// Ask for a value.
    Query(Query),
    /// Count in angstroms from now on.
    Angstroms,
    /// Go to a wavelength in angstroms.
    Goto(u16),
}

/// Values that can be asked for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum Query {
    /// Position in the present units.
    Position = 0,
    /// Grooves a millimetre of the grating in use.
    Grooves = 2,
    /// Grating in use.
    Grating = 4,
    /// Number of gratings.
    Gratings = 13,
    /// Units code.
    Units = 14,
    /// Serial number.
    Serial = 19,
}

/// A status byte.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Status(pub u8);

/// What came after an ECHO.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Echo {
    /// The echo and nothing else.
    Exact,
    /// Something else.
    Other,
    /// Nothing.
    Silence,
}

/// A link to one monochromator.
pub(super) struct Cm110Wire {
    connector: Box<dyn Connector>,
    link: Option<Link>,
    pub(super) clock: Clock,
    pub(super) label: String,
    /// The last exchange has no proven end: synchronise before the next.
    suspect: bool,
    /// The drive may move, and so be deaf, until then.
    deaf_until: Option<Instant>,
}

// === impl Request ===

impl Request {
    /// The bytes on the wire; parameters are big-endian.
    pub fn bytes(self) -> Vec<u8> {
        match self {
            Request::Query(query) => vec![56, query as u8],
            Request::Angstroms => vec![50, ANGSTROM],
            Request::Goto(angstroms) => {
                let [high, low] = angstroms.to_be_bytes();
                vec![16, high, low]
            }
        }
    }
}

// === impl Status ===

impl Status {
    /// The command was rejected.
    pub fn rejected(self) -> bool {
        self.0 & 0x80 != 0
    }

    /// Why, for a person.
    pub fn reason(self) -> &'static str {
        if self.0 & 0x20 != 0 { "the value is too small" } else { "the value is too large" }
    }

    /// Units in force: 0 micrometre, 1 nanometre, 2 angstrom.
    pub fn units(self) -> u8 {
        self.0 & 0x07
    }
}

// === impl Cm110Wire ===

impl Cm110Wire {
    /// A wire for the device `name`; nothing is opened yet.
    pub(super) fn new(name: &str, connector: Box<dyn Connector>, clock: Clock) -> Cm110Wire {
        let label = format!("{name} ({})", connector.port());
        Cm110Wire { connector, link: None, clock, label, suspect: true, deaf_until: None }
    }

    pub(super) fn error(&self, kind: ErrorKind, message: impl Into<String>) -> DeviceError {
        DeviceError::new(kind, &self.label, message)
    }

    /// Makes sure that a synchronised link is there, connecting anew when the old one is dead.
    pub(super) async fn ensure(&mut self) -> Result<()> {
        if self.link.is_some() && self.synchronise().await.is_ok() {
            return Ok(());
        }
        let connected = self.connector.connect().await;
        self.link = Some(connected.map_err(|e| self.error(e.kind, e.message))?);
        self.synchronise().await
    }

    /// Waits for the end of a move that may be under way, then sends ECHO until its exact answer comes, and once more
    /// for proof. Six tries: a box in the middle of a command swallows them as parameters.
    pub(super) async fn synchronise(&mut self) -> Result<()> {
        self.suspect = true;
        while self.deaf_until.is_some_and(|until| self.clock.now() < until) {
            if self.echo().await? == Echo::Exact {
                break;
            }
            self.clock.sleep(MOVING_POLL).await;
        }
        self.deaf_until = None;
        let mut heard = false;
        let begun = self.clock.now();
        let mut tries = 0;
        while tries < SYNC_TRIES || (heard && self.clock.now() < begun + STRAY_MOVE) {
            let first = self.echo().await?;
            if first == Echo::Exact && self.echo().await? == Echo::Exact {
                self.suspect = false;
                return Ok(());
            }
            heard |= first != Echo::Silence;
            tries += 1;
        }
        let what = format!(
            "no exact answer to ECHO in {SYNC_TRIES} tries; check power, cable, that it does not move just now and that the right device is connected"
        );
        Err(self.error(ErrorKind::Timeout, what))
    }

    /// One echo.
    async fn echo(&mut self) -> Result<Echo> {
        let deadline_after = |clock: &Clock| clock.now() + ECHO_LIMIT;
        let clock = self.clock;
        let link = self.link()?;
        let work = async {
            let before = link.drain(QUIET).await?;
            link.send(&[ECHO]).await?;
            let answer = link.exactly(1, deadline_after(&clock)).await?;
            Ok((answer, before, link.unsolicited().await?))
        };
        let (answer, before, late) = work.await.map_err(|e| self.fail(e))?;
        Ok(match answer.as_deref() {
            Some(&[ECHO]) if late == 0 => Echo::Exact,
            None if before == 0 => Echo::Silence,
            _ => Echo::Other,
        })
    }

    /// Value and status of a query, asked until two answers in a row agree; lost and garbled answers are asked again.
    pub(super) async fn query(&mut self, query: Query) -> Result<(u16, Status)> {
        let mut last = None;
        let mut failure = None;
        for _ in 0..AGREE_TRIES {
            match self.query_once(query).await {
                Ok(answer) if last == Some(answer) => return Ok(answer),
                Ok(answer) => last = Some(answer),
                Err(error) if matches!(error.kind, ErrorKind::Timeout | ErrorKind::Garbled) => failure = Some(error),
                Err(error) => return Err(error),
            }
        }
        Err(failure.unwrap_or_else(|| {
            self.error(ErrorKind::Garbled, format!("no two answers to QUERY {query:?} agree; check cable and earthing"))
        }))
    }

    async fn query_once(&mut self, query: Query) -> Result<(u16, Status)> {
        let request = Request::Query(query);
        self.send(request).await?;
        let deadline = self.clock.now() + REPLY_LIMIT;
        let Some(reply) = self.take(4, deadline).await? else {
            let echoed = self.take(2, self.clock.now()).await?;
            if echoed == Some(request.bytes()) {
                let what = "it echoes what is sent instead of answering: another device; connect the monochromator or correct `port`";
                return Err(self.error(ErrorKind::WrongDevice, what));
            }
            return Err(self.error(ErrorKind::Timeout, format!("no answer to QUERY {query:?} within 0.5 s")));
        };
        match reply.as_slice() {
            &[high, low, status, END] if status & 0x80 == 0 => {
                self.suspect = false;
                Ok((u16::from_be_bytes([high, low]), Status(status)))
            }
            other => Err(self.error(ErrorKind::Garbled, format!("QUERY {query:?} was answered with {other:02x?}"))),
        }
    }

    /// Sends a setting once and waits for its end, at most `limit` after the status. `Refused` is the device's own no;
    /// after `Timeout` or `Garbled` the device may or may not have acted.
    pub(super) async fn command(&mut self, request: Request, limit: Duration) -> Result<Status> {
        self.send(request).await?;
        self.deaf_until = Some(self.clock.now() + limit);
        let Some(status) = self.take(1, self.clock.now() + REPLY_LIMIT).await? else {
            return Err(self.error(ErrorKind::Timeout, format!("no status within 0.5 s after {request:?}")));
        };
        let status = Status(status.first().copied().unwrap_or_default());
        if status.rejected() {
            let _ = self.take(1, self.clock.now() + REJECTION_END).await?;
            return Err(self.error(ErrorKind::Refused, format!("the device rejected {request:?}: {}", status.reason())));
        }
        match self.take(1, self.clock.now() + limit).await?.as_deref() {
            Some(&[END]) => {
                self.suspect = false;
                self.deaf_until = None;
                Ok(status)
            }
            Some(other) => Err(self.error(ErrorKind::Garbled, format!("{request:?} was ended with {other:02x?}"))),
            None => {
                let what = format!("{request:?} did not end within {} s", limit.as_secs_f64());
                Err(self.error(ErrorKind::Timeout, what))
            }
        }
    }

    /// Sends over a line that is proven quiet and in step; from here on the exchange has no proven end.
    async fn send(&mut self, request: Request) -> Result<()> {
        if !self.suspect {
            let early = self.link()?.unsolicited().await;
            self.suspect = early.map_err(|e| self.fail(e))? > 0;
        }
        if self.suspect {
            self.synchronise().await?;
        }
        self.suspect = true;
        let sent = self.link()?.send(&request.bytes()).await;
        sent.map_err(|e| self.fail(e))
    }

    async fn take(&mut self, count: usize, deadline: Instant) -> Result<Option<Vec<u8>>> {
        let taken = self.link()?.exactly(count, deadline).await;
        taken.map_err(|e| self.fail(e))
    }

    fn link(&mut self) -> Result<&mut Link> {
        match self.link.as_mut() {
            Some(link) => Ok(link),
            None => Err(DeviceError::new(ErrorKind::Lost, &self.label, "the device is not connected; open it first")),
        }
    }

    /// Notes a lost link and names the device in the error.
    fn fail(&mut self, error: DeviceError) -> DeviceError {
        if error.kind == ErrorKind::Lost {
            self.link = None;
        }
        self.error(error.kind, error.message)
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used)]
    use super::*;

    #[test]
    fn requests_are_the_worked_exchange() {
        assert_eq!(Request::Query(Query::Units).bytes(), [0x38, 0x0e]);
        assert_eq!(Request::Angstroms.bytes(), [0x32, 0x02]);
        assert_eq!(Request::Goto(5500).bytes(), [0x10, 0x15, 0x7c]);
        assert_eq!(Request::Goto(6168).bytes(), [0x10, 0x18, 0x18]);
        assert_eq!((Query::Position as u8, Query::Gratings as u8, Query::Serial as u8), (0, 13, 19));
    }

    /// First bytes of ZERO, INC, DEC, CALIBRATE and RESET.
    #[test]
    fn nothing_that_changes_the_calibration_can_be_encoded() {
        let mut all = vec![Request::Angstroms];
        all.extend((0..=u16::MAX).map(Request::Goto));
        for query in [Query::Position, Query::Grooves, Query::Grating, Query::Gratings, Query::Units, Query::Serial] {
            all.push(Request::Query(query));
        }
        assert!(all.iter().all(|r| ![52, 7, 1, 18, 255].contains(&r.bytes()[0])));
    }

    #[test]
    fn status_bytes_are_those_of_the_sheet() {
        assert!(!Status(0x02).rejected() && !Status(0x42).rejected());
        assert_eq!(
            (Status(0x82).reason(), Status(0xa2).reason()),
            ("the value is too large", "the value is too small")
        );
        assert_eq!((Status(0x62).units(), Status(0x01).units()), (2, 1));
    }
}
