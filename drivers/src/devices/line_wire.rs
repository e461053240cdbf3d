//! Lines without echo or checksum (Newport ESP301 and SMC100, Optec IFW): one request, at most one line back.
//!
//! After anything that has no proven end (lost, cut, garbled, cancelled, bytes unasked) the line is drained until quiet
//! and the device's no-op must give its exact answer before the next request. A value that decides something is asked
//! until two answers in a row agree.

use crate::clock::Clock;
use crate::error::{DeviceError, ErrorKind, Result};
use crate::transport::{Connector, Link};
use std::time::Duration;

/// Quiet time that ends a drain.
const QUIET: Duration = Duration::from_millis(100);
/// Tries of the no-op.
const SYNC_TRIES: u32 = 3;
/// Queries for two agreeing answers.
const AGREE_TRIES: u32 = 8;
/// Failures (no answer, or one that cannot be) in one query before it is given up.
const FAILURES: u32 = 3;

/// What is spoken on a line.
#[derive(Debug, Clone, Copy)]
pub(super) struct Dialect {
    /// Sent after each request.
    pub request_end: &'static str,
    /// Byte that ends a reply.
    pub reply_end: u8,
    /// Limit of a query.
    pub limit: Duration,
}

/// A harmless request and the one answer it must get.
#[derive(Debug, Clone)]
pub(super) struct NoOp {
    /// Request without its end.
    pub request: String,
    /// Answer without its end.
    pub answer: String,
}

/// A link to the devices on one line.
pub(super) struct LineWire {
    connector: Box<dyn Connector>,
    link: Option<Link>,
    dialect: Dialect,
    noop: Option<NoOp>,
    suspect: bool,
    pub(super) clock: Clock,
    /// Times that bytes came without being asked for.
    pub(super) unsolicited: u64,
}

// === impl LineWire ===

impl LineWire {
    /// A wire over `connector`; nothing is opened yet.
    pub(super) fn new(connector: Box<dyn Connector>, dialect: Dialect, clock: Clock) -> LineWire {
        LineWire { connector, link: None, dialect, noop: None, suspect: true, clock, unsolicited: 0 }
    }

    pub(super) fn error(&self, kind: ErrorKind, message: impl Into<String>) -> DeviceError {
        DeviceError::new(kind, self.connector.port(), message)
    }

    /// True when the old link still answers its no-op exactly.
    pub(super) async fn alive(&mut self) -> bool {
        self.link.is_some() && self.noop.is_some() && self.resync().await.is_ok()
    }

    /// Opens the port anew, forgets the no-op and drains what is there.
    pub(super) async fn connect(&mut self) -> Result<()> {
        self.link = None;
        self.noop = None;
        self.suspect = true;
        self.unsolicited = 0;
        self.link = Some(self.connector.connect().await?);
        self.resync().await
    }

    /// From now on this answer proves the line.
    pub(super) fn trust(&mut self, noop: NoOp) {
        self.noop = Some(noop);
    }

    /// The no-op is not understood at present (a restart left its mode): a quiet line is enough.
    pub(super) fn forget(&mut self) {
        self.noop = None;
        self.suspect = true;
    }

    /// The last answer was none of its request: synchronise before the next one.
    pub(super) fn distrust(&mut self) {
        self.suspect = true;
    }

    /// Throws away what comes until the line is quiet, then requires the no-op's exact answer, where one is known.
    pub(super) async fn resync(&mut self) -> Result<()> {
        self.suspect = true;
        let mut last = None;
        for _ in 0..SYNC_TRIES {
            let drained = match self.link.as_mut() {
                Some(link) => link.drain(QUIET).await,
                None => Err(self.not_open()),
            };
            drained.map_err(|e| self.fail(e))?;
            let Some(noop) = self.noop.clone() else {
                self.suspect = false;
                return Ok(());
            };
            let line = self.exchange(&noop.request, self.dialect.limit).await?;
            if line.as_deref() == Some(noop.answer.as_str()) {
                self.suspect = false;
                return Ok(());
            }
            last = line.or(last);
        }
        let request = self.noop.as_ref().map_or("", |n| n.request.as_str());
        Err(match last {
            Some(line) => self.error(
                ErrorKind::Garbled,
                format!("`{request}` gives {line:?}, not what it gave before; open it again"),
            ),
            None => self.error(
                ErrorKind::Timeout,
                format!("no answer to `{request}` in {SYNC_TRIES} tries; check power, cable and baud rate"),
            ),
        })
    }

    /// Sends a request that has no answer.
    pub(super) async fn send(&mut self, request: &str) -> Result<()> {
        self.ready().await?;
        let bytes = format!("{request}{}", self.dialect.request_end);
        let Some(link) = self.link.as_mut() else { return Err(self.not_open()) };
        let sent = link.send(bytes.as_bytes()).await;
        sent.map_err(|e| self.fail(e))
    }

    /// Sends a request once and gives the line that comes, `None` when none comes within `limit`.
    pub(super) async fn ask(&mut self, request: &str, limit: Duration) -> Result<Option<String>> {
        self.ready().await?;
        self.suspect = true;
        let line = self.exchange(request, limit).await?;
        self.suspect = line.is_none();
        Ok(line)
    }

    /// The answer to a query, read by `read`, once two in a row agree. Lost answers and such as `read` does not take
    /// are asked again.
    pub(super) async fn agreed<T: PartialEq + Send>(
        &mut self,
        request: &str,
        read: impl Fn(&str) -> Option<T> + Send + Sync,
    ) -> Result<T> {
        let mut last: Option<T> = None;
        let mut failures = 0;
        let mut failure = None;
        for _ in 0..AGREE_TRIES {
            let why = match self.ask(request, self.dialect.limit).await {
                Ok(Some(line)) => match read(&line) {
                    Some(value) if last.as_ref() == Some(&value) => return Ok(value),
                    Some(value) => {
                        last = Some(value);
                        continue;
                    }
                    None => {
                        self.distrust();
                        self.error(ErrorKind::Garbled, format!("{line:?} is no answer to `{request}`"))
                    }
                },
                Ok(None) => self.error(
                    ErrorKind::Timeout,
                    format!(
                        "no answer to `{request}` within {} s; check power and cable",
                        self.dialect.limit.as_secs_f64()
                    ),
                ),
                Err(error) if matches!(error.kind, ErrorKind::Timeout | ErrorKind::Garbled) => error,
                Err(error) => return Err(error),
            };
            failure = Some(why);
            failures += 1;
            if failures >= FAILURES {
                break;
            }
        }
        Err(failure.unwrap_or_else(|| {
            self.error(ErrorKind::Garbled, format!("no two answers to `{request}` agree; check cable and earthing"))
        }))
    }

    /// A quiet line: bytes that came unasked are counted and thrown away.
    async fn ready(&mut self) -> Result<()> {
        if !self.suspect {
            let early = match self.link.as_mut() {
                Some(link) => link.unsolicited().await,
                None => Err(self.not_open()),
            };
            if early.map_err(|e| self.fail(e))? > 0 {
                self.unsolicited += 1;
                self.suspect = true;
            }
        }
        if self.suspect { self.resync().await } else { Ok(()) }
    }

    /// One request and the first line with text in it. Bytes that are no ASCII text make it an unreadable line.
    async fn exchange(&mut self, request: &str, limit: Duration) -> Result<Option<String>> {
        let Dialect { request_end, reply_end, .. } = self.dialect;
        let deadline = self.clock.now() + limit;
        let Some(link) = self.link.as_mut() else { return Err(self.not_open()) };
        let read = async {
            link.send(format!("{request}{request_end}").as_bytes()).await?;
            while let Some(line) = link.until(reply_end, deadline).await? {
                let text = String::from_utf8_lossy(&line).into_owned();
                let text = text.trim_matches(|c| matches!(c, '\r' | '\n' | '\0'));
                if !text.trim().is_empty() {
                    return Ok(Some(text.to_owned()));
                }
            }
            Ok(None)
        };
        let read = read.await;
        read.map_err(|e| self.fail(e))
    }

    /// Notes a lost link.
    fn fail(&mut self, error: DeviceError) -> DeviceError {
        if error.kind == ErrorKind::Lost {
            self.link = None;
        }
        self.suspect = true;
        error
    }

    fn not_open(&self) -> DeviceError {
        self.error(ErrorKind::Lost, "the device is not connected; open it first")
    }
}
