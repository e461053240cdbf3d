//! One Zaber daisy chain: the single owner of its link, shared by its axes, one request at a time.

use super::AxisConfig;
use super::zaber_ascii::ZaberAxis;
use super::zaber_protocol::{Address, Command, Message, Reply, encode, parse};
use crate::clock::Clock;
use crate::error::{DeviceError, ErrorKind, Result};
use crate::transport::{Connector, Link};
use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::{Mutex, MutexGuard};

/// A reply takes a few milliseconds.
const REPLY_LIMIT: Duration = Duration::from_millis(500);
/// Quiet time after opening.
const QUIET: Duration = Duration::from_millis(100);
/// Tries of a request that may be repeated.
const TRIES: u32 = 3;
/// Of these, requests without any reply: what stays silent needs more than asking again.
const MOST_SILENCES: u32 = 2;
/// Answers `AGAIN` or `FULL` taken before giving up.
const AGAIN_TRIES: u32 = 5;
/// Wait before asking again.
const AGAIN_PAUSE: Duration = Duration::from_millis(50);
/// Longest wait for the chain while other axes talk; several exchanges with all their repeats fit.
const LOCK_LIMIT: Duration = Duration::from_secs(10);

/// A chain of Zaber devices on one port.
pub struct ZaberChain {
    shared: Shared,
    axes: Vec<AxisConfig>,
}

/// What the axes of a chain share.
#[derive(Clone)]
pub(super) struct Shared {
    wire: Arc<Mutex<Wire>>,
    pub(super) clock: Clock,
    pub(super) port: String,
}

/// The link and what is known of it.
pub(super) struct Wire {
    connector: Box<dyn Connector>,
    link: Option<Link>,
    clock: Clock,
    next_id: u8,
    next_echo: u32,
    /// Devices whose replies must carry a checksum.
    pub(super) checked: BTreeSet<u8>,
    /// Alerts seen since the link was made.
    pub(super) alerts: u64,
}

// === impl ZaberChain ===

impl ZaberChain {
    /// A chain over `connector` with the configured axes; nothing is sent before an axis is opened.
    pub fn new(connector: Box<dyn Connector>, axes: Vec<AxisConfig>, clock: Clock) -> ZaberChain {
        let port = connector.port().to_owned();
        let wire = Wire { connector, link: None, clock, next_id: 0, next_echo: 1, checked: BTreeSet::new(), alerts: 0 };
        ZaberChain { shared: Shared { wire: Arc::new(Mutex::new(wire)), clock, port }, axes }
    }

    /// The axis with the configured name; `Refused` names the axes there are.
    pub fn axis(&self, name: &str) -> Result<ZaberAxis> {
        match self.axes.iter().find(|a| a.name == name) {
            Some(config) => Ok(ZaberAxis::new(self.shared.clone(), config.clone())),
            None => {
                let known: Vec<&str> = self.axes.iter().map(|a| a.name.as_str()).collect();
                let message = format!("no axis `{name}` is configured; there are: {}", known.join(", "));
                Err(DeviceError::new(ErrorKind::Refused, &self.shared.port, message))
            }
        }
    }

    /// All axes in the order of the configuration.
    pub fn axes(&self) -> Vec<ZaberAxis> {
        self.axes.iter().map(|config| ZaberAxis::new(self.shared.clone(), config.clone())).collect()
    }
}

// === impl Shared ===

impl Shared {
    /// The wire, waited for within a limit.
    pub(super) async fn wire(&self) -> Result<MutexGuard<'_, Wire>> {
        self.clock.timeout(LOCK_LIMIT, self.wire.lock()).await.map_err(|_| {
            DeviceError::new(ErrorKind::Busy, &self.port, "other axes of the chain have talked for 10 s; try again")
        })
    }
}

// === impl Wire ===

impl Wire {
    /// Makes sure that a link is there and `device` echoes a fresh word over it; connects anew when it does not.
    pub(super) async fn ensure(&mut self, device: u8) -> Result<()> {
        if self.link.is_some() && self.echo(device).await.is_ok() {
            return Ok(());
        }
        self.link = None;
        self.checked.clear();
        self.link = Some(self.connector.connect().await?);
        if let Some(link) = self.link.as_mut() {
            link.drain(QUIET).await?;
        }
        self.echo(device).await
    }

    /// The harmless no-op with a word that was not used before.
    async fn echo(&mut self, device: u8) -> Result<()> {
        self.next_echo = self.next_echo.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        let word = self.next_echo % 1_000_000;
        let reply = self.ask(Address { device, axis: 0 }, Command::Echo(word)).await?;
        if reply.accepted && reply.data.trim() == word.to_string() {
            Ok(())
        } else {
            let what = format!("device {device} answered `{}` to `tools echo {word}`", reply.data);
            Err(DeviceError::new(ErrorKind::Garbled, self.connector.port(), what))
        }
    }

    /// Sends a request and gives its reply, accepted or rejected. Repeats what may be repeated; `AGAIN` and `FULL`
    /// are asked again a bounded number of times, then `Busy`.
    pub(super) async fn ask(&mut self, at: Address, command: Command) -> Result<Reply> {
        let tries = if command.repeatable() { TRIES } else { 1 };
        let (mut failed, mut silent, mut again) = (0, 0, 0);
        loop {
            match self.exchange(at, command).await {
                Ok(reply) if !reply.accepted && matches!(reply.data.as_str(), "AGAIN" | "FULL") => {
                    again += 1;
                    if again > AGAIN_TRIES {
                        let what = format!("device {} keeps answering {}", at.device, reply.data);
                        return Err(DeviceError::new(ErrorKind::Busy, self.connector.port(), what));
                    }
                    self.clock.sleep(AGAIN_PAUSE).await;
                }
                Ok(reply) => return Ok(reply),
                Err(error) => {
                    failed += 1;
                    silent += u32::from(error.kind == ErrorKind::Timeout);
                    if error.kind == ErrorKind::Lost {
                        self.link = None;
                    }
                    let over = failed >= tries || silent >= MOST_SILENCES;
                    if over || !matches!(error.kind, ErrorKind::Timeout | ErrorKind::Garbled) {
                        return Err(error);
                    }
                    tracing::debug!(port = self.connector.port(), %command, %error, "asking again");
                }
            }
        }
    }

    /// One request, one reply with its id. Lines of others are sorted out.
    async fn exchange(&mut self, at: Address, command: Command) -> Result<Reply> {
        let id = self.next_id;
        self.next_id = (id + 1) % 100;
        let checked = self.checked.contains(&at.device);
        let port = self.connector.port().to_owned();
        let Some(link) = self.link.as_mut() else {
            let what = "the chain is not connected; open the axis again";
            return Err(DeviceError::new(ErrorKind::Lost, port, what));
        };
        link.send(&encode(at, id, command)).await?;
        let deadline = self.clock.now() + REPLY_LIMIT;
        let mut defect = None;
        let mut assembly: Option<(Reply, u32)> = None;
        while let Some(line) = link.line(deadline).await? {
            match parse(&line, checked) {
                Ok(Message::Reply(reply)) if reply.at == at && reply.id == Some(id) => {
                    if !reply.data.ends_with('\\') {
                        return Ok(reply);
                    }
                    assembly = Some((reply, 0));
                }
                Ok(Message::Info(from, Some(info_id), text)) if from == at && info_id == id => {
                    if let Some(reply) = assembly.as_mut().and_then(|(reply, n)| append(reply, n, &text)) {
                        return Ok(reply);
                    }
                }
                Ok(Message::Alert(from, text)) => {
                    self.alerts += 1;
                    tracing::info!(%port, device = from.device, axis = from.axis, alert = text, "alert");
                }
                Ok(other) => tracing::debug!(%port, ?other, "not the answer to this request"),
                Err(why) => defect = Some(why),
            }
        }
        let asked = format!("device {} axis {}, `{command}`", at.device, at.axis);
        Err(match defect {
            Some(why) => {
                DeviceError::new(ErrorKind::Garbled, port, format!("{why} ({asked}); check cable and earthing"))
            }
            None => {
                let what = format!("no answer within 0.5 s ({asked}); check power, cable and device number");
                DeviceError::new(ErrorKind::Timeout, port, what)
            }
        })
    }
}

/// Adds the info text `cont N words` to a reply whose data ends in a backslash; gives the whole when it is complete.
fn append(reply: &mut Reply, last: &mut u32, text: &str) -> Option<Reply> {
    let (number, words) = text.strip_prefix("cont ")?.split_once(' ')?;
    if number.parse() != Ok(*last + 1) {
        return None;
    }
    *last += 1;
    reply.data = format!("{} {words}", reply.data.trim_end_matches('\\').trim_end()).trim_start().to_owned();
    (!reply.data.ends_with('\\')).then(|| reply.clone())
}
