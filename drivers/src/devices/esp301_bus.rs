//! One ESP300/ESP301 controller: the single owner of its link, shared by its axes. The controller has one error queue
//! for all axes; what belongs to another axis is kept for it.

use super::AxisConfig;
use super::esp301_protocol::{Order, Query, Report};
use super::line_wire::{Dialect, LineWire, NoOp};
use super::newport_esp301::Esp301Axis;
use crate::clock::Clock;
use crate::error::{DeviceError, ErrorKind, Result};
use crate::transport::Connector;
use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::{Mutex, MutexGuard};

/// Requests end with CR, replies with CR LF.
const DIALECT: Dialect = Dialect { request_end: "\r", reply_end: b'\n', limit: Duration::from_secs(1) };
/// Longest wait for the controller while other axes talk.
const LOCK_LIMIT: Duration = Duration::from_secs(30);
/// Entries of the error queue (ten on a sibling controller) and the 0 that ends it.
const QUEUE_READS: u32 = 12;
/// Reports of other axes kept at most.
const KEPT: usize = 64;

/// The axes of one controller.
pub struct Esp301 {
    shared: Shared,
    axes: Vec<AxisConfig>,
}

/// What the axes share.
#[derive(Clone)]
pub(super) struct Shared {
    bus: Arc<Mutex<Bus>>,
    pub(super) clock: Clock,
    pub(super) port: String,
}

/// The link and the reports that wait for their axis.
pub(super) struct Bus {
    pub(super) wire: LineWire,
    axes: Vec<u8>,
    kept: VecDeque<(u8, Report)>,
    last_report: String,
}

/// What the error queue told.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(super) struct Told {
    /// Reports of this axis or of the controller, oldest first.
    pub reports: Vec<Report>,
    /// No answer was lost, so nothing is missing from the reports.
    pub certain: bool,
}

// === impl Esp301 ===

impl Esp301 {
    /// A controller over `connector` with the configured axes; nothing is sent before an axis is opened.
    pub fn new(connector: Box<dyn Connector>, axes: Vec<AxisConfig>, clock: Clock) -> Esp301 {
        let port = connector.port().to_owned();
        let wire = LineWire::new(connector, DIALECT, clock);
        let numbers = axes.iter().map(|a| a.axis).collect();
        let bus = Bus { wire, axes: numbers, kept: VecDeque::new(), last_report: String::new() };
        Esp301 { shared: Shared { bus: Arc::new(Mutex::new(bus)), clock, port }, axes }
    }

    /// All axes in the order of the configuration.
    pub fn axes(&self) -> Vec<Esp301Axis> {
        self.axes.iter().map(|config| Esp301Axis::new(self.shared.clone(), config.clone())).collect()
    }
}

// === impl Shared ===

impl Shared {
    /// The bus, waited for within a limit.
    pub(super) async fn bus(&self) -> Result<MutexGuard<'_, Bus>> {
        self.clock.timeout(LOCK_LIMIT, self.bus.lock()).await.map_err(|_| {
            DeviceError::new(
                ErrorKind::Busy,
                &self.port,
                "other axes of the controller have talked for 30 s; try again",
            )
        })
    }
}

// === impl Bus ===

impl Bus {
    /// Makes sure that the controller answers, connecting anew when the old link is dead; gives its version text.
    pub(super) async fn ensure(&mut self) -> Result<String> {
        if !self.wire.alive().await {
            self.wire.connect().await?;
            self.kept.clear();
            self.wire.send("").await?;
            self.wire.resync().await?;
        }
        let version = self.wire.agreed("VE?", |line| Some(line.to_owned())).await?;
        if !version.contains("ESP") {
            let what = format!("it says {version:?}, a Newport ESP300 or ESP301 is needed; correct `port`");
            return Err(self.wire.error(ErrorKind::WrongDevice, what));
        }
        self.wire.trust(NoOp { request: "VE?".to_owned(), answer: version.clone() });
        Ok(version)
    }

    /// The answer of an axis, once two in a row agree.
    pub(super) async fn query<T: PartialEq + Send>(
        &mut self,
        axis: u8,
        query: Query,
        read: impl Fn(&str) -> Option<T> + Send + Sync,
    ) -> Result<T> {
        self.wire.agreed(&format!("{axis}{}", query.words()), read).await
    }

    /// A finite number of an axis.
    pub(super) async fn number(&mut self, axis: u8, query: Query) -> Result<f64> {
        self.query(axis, query, |line| line.trim().parse::<f64>().ok().filter(|v| v.is_finite())).await
    }

    /// A question that 0 or 1 answers.
    pub(super) async fn flag(&mut self, axis: u8, query: Query) -> Result<bool> {
        let read = |line: &str| match line.trim() {
            "0" => Some(false),
            "1" => Some(true),
            _ => None,
        };
        self.query(axis, query, read).await
    }

    /// Sends an order alone and empties the error queue after it.
    pub(super) async fn order(&mut self, axis: u8, order: Order) -> Result<Told> {
        self.wire.send(&format!("{axis}{order}")).await?;
        self.reports(axis).await
    }

    /// Empties the error queue; what belongs to other axes is kept for them. Reading takes an entry off, so a lost
    /// answer may be a lost report: the result is then not certain.
    pub(super) async fn reports(&mut self, axis: u8) -> Result<Told> {
        let mut told = Told { reports: Vec::new(), certain: true };
        let mut lost = 0;
        for _ in 0..QUEUE_READS {
            let line = match self.wire.ask("TB?", DIALECT.limit).await {
                Ok(line) => line,
                Err(error) if error.kind == ErrorKind::Garbled => None,
                Err(error) => return Err(error),
            };
            // The stamp counts servo ticks, so a line that is equal to the last one is an old one.
            let fresh = line.filter(|l| *l != self.last_report);
            let Some((report, line)) = fresh.and_then(|l| Report::parse(&l).map(|r| (r, l))) else {
                self.wire.distrust();
                told.certain = false;
                lost += 1;
                if lost > 3 {
                    let what = "the error queue cannot be read (`TB?`); check cable and earthing";
                    return Err(self.wire.error(ErrorKind::Garbled, what));
                }
                self.last_report.clear();
                continue;
            };
            self.last_report = line;
            if report.0 == 0 {
                break;
            }
            self.file(axis, report, &mut told);
        }
        let mine: Vec<Report> = self.kept.iter().filter(|(a, _)| *a == axis).map(|(_, r)| *r).collect();
        self.kept.retain(|(a, _)| *a != axis);
        told.reports.splice(0..0, mine);
        Ok(told)
    }

    fn file(&mut self, axis: u8, report: Report, told: &mut Told) {
        tracing::info!(axis, code = report.0, "error report of the controller");
        let others: Vec<u8> = match report.axis() {
            Some(owner) if owner != axis => vec![owner],
            None if report.concerns_all() => self.axes.iter().copied().filter(|a| *a != axis).collect(),
            _ => Vec::new(),
        };
        if report.axis().is_none_or(|owner| owner == axis) {
            told.reports.push(report);
        }
        for other in others {
            if self.kept.len() >= KEPT {
                self.kept.pop_front();
            }
            self.kept.push_back((other, report));
        }
    }
}
