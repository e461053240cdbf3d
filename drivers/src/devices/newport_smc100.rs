//! Driver `newport-smc100`: rotation stages on Newport SMC100 boxes, one axis a box, chained by address.
//!
//! The box is a state machine that tells whether it has a reference. It has no serial number of its own: the stage's
//! identifier (`ID?`, from the stage's memory) must contain the configured one. Positions are in the units of the stage,
//! which for a rotation stage are degrees; the box cannot be asked for them.

use super::AxisConfig;
use super::line_wire::{Dialect, LineWire, NoOp};
use super::smc100_protocol::{Order, Query, State, Status, meaning};
use crate::clock::Clock;
use crate::contract::{Device, Health, Identity, RotaryAxis};
use crate::error::{DeviceError, ErrorKind, Result};
use crate::transport::Connector;
use crate::units::{Degrees, DegreesPerSecond};
use async_trait::async_trait;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::{Mutex, MutexGuard};

/// Line of the chain.
pub const BAUD: u32 = 57_600;
/// Both ways CR LF.
const DIALECT: Dialect = Dialect { request_end: "\r\n", reply_end: b'\n', limit: Duration::from_millis(500) };
/// Pause after a command that is not answered.
const PAUSE: Duration = Duration::from_millis(60);
/// Longest wait for the line while other boxes are talked to.
const LOCK_LIMIT: Duration = Duration::from_secs(30);
/// Poll interval while an axis moves.
const POLL: Duration = Duration::from_millis(100);
/// Added to every computed travel time.
const MOVE_MARGIN: Duration = Duration::from_secs(3);
/// Times that a position is commanded before a wrong place is a fault.
const MOVE_TRIES: u32 = 2;
/// Relative difference at which a read-back speed is still the one written.
const SAME: f64 = 1e-3;

/// The boxes of one line.
pub struct Smc100 {
    wire: Arc<Mutex<LineWire>>,
    axes: Vec<AxisConfig>,
    clock: Clock,
    port: String,
}

/// One box.
pub struct Smc100Axis {
    wire: Arc<Mutex<LineWire>>,
    config: AxisConfig,
    clock: Clock,
    label: String,
    /// The box's own limits; known after `open`.
    limits: Option<(f64, f64)>,
    /// It had a reference when last seen.
    referenced: bool,
}

// === impl Smc100 ===

impl Smc100 {
    /// A line over `connector` with the configured boxes; nothing is sent before an axis is opened.
    pub fn new(connector: Box<dyn Connector>, axes: Vec<AxisConfig>, clock: Clock) -> Smc100 {
        let port = connector.port().to_owned();
        Smc100 { wire: Arc::new(Mutex::new(LineWire::new(connector, DIALECT, clock))), axes, clock, port }
    }

    /// All axes in the order of the configuration.
    pub fn axes(&self) -> Vec<Smc100Axis> {
        let axis = |config: &AxisConfig| Smc100Axis {
            wire: Arc::clone(&self.wire),
            label: format!("{} ({})", config.name, self.port),
            config: config.clone(),
            clock: self.clock,
            limits: None,
            referenced: false,
        };
        self.axes.iter().map(axis).collect()
    }
}

// === impl Smc100Axis ===

impl Smc100Axis {
    fn error(&self, kind: ErrorKind, message: impl Into<String>) -> DeviceError {
        DeviceError::new(kind, &self.label, message)
    }

    fn own(&self, error: DeviceError) -> DeviceError {
        self.error(error.kind, error.message)
    }

    fn opened(&self) -> Result<(f64, f64)> {
        self.limits.ok_or_else(|| self.error(ErrorKind::Refused, "the axis is not open; open it first"))
    }

    async fn wire(&self) -> Result<MutexGuard<'_, LineWire>> {
        self.clock
            .timeout(LOCK_LIMIT, self.wire.lock())
            .await
            .map_err(|_| self.error(ErrorKind::Busy, "other boxes of the chain have talked for 30 s; try again"))
    }

    /// The answer of this box, once two in a row agree.
    async fn ask<T: PartialEq + Send>(
        &self,
        query: Query,
        read: impl Fn(String) -> Option<T> + Send + Sync,
    ) -> Result<T> {
        let address = self.config.device;
        let request = format!("{address}{}", query.words());
        let answer = self.wire().await?.agreed(&request, |line| query.value(address, line).and_then(&read)).await;
        answer.map_err(|e| self.own(e))
    }

    async fn number(&self, query: Query) -> Result<f64> {
        self.ask(query, |text| text.parse::<f64>().ok().filter(|v| v.is_finite())).await
    }

    async fn status(&self) -> Result<Status> {
        self.ask(Query::State, |text| Status::parse(&text)).await
    }

    /// Sends an order and reads the error of it. Reading clears it, so it is asked once; true when it is sure that the
    /// box took the order.
    async fn order(&mut self, order: Order, doing: &str) -> Result<bool> {
        let address = self.config.device;
        let asked = {
            let mut wire = self.wire().await?;
            let sent = wire.send(&format!("{address}{order}")).await;
            sent.map_err(|e| self.own(e))?;
            wire.clock.sleep(PAUSE).await;
            wire.ask(&format!("{address}{}", Query::Error.words()), DIALECT.limit).await
        };
        let line = match asked {
            Ok(line) => line,
            Err(error) if error.kind == ErrorKind::Garbled => None,
            Err(error) => return Err(self.own(error)),
        };
        let text = line.and_then(|l| Query::Error.value(address, &l)).unwrap_or_default();
        let mut letters = text.chars();
        match (letters.next(), letters.next()) {
            (Some(letter @ ('@' | 'A'..='Z')), None) => match meaning(letter) {
                None => Ok(true),
                Some((kind, what)) => {
                    self.referenced &= letter != 'H';
                    Err(self.error(kind, format!("{doing}: error {letter}, {what}")))
                }
            },
            _ => {
                self.wire().await?.distrust();
                Ok(false)
            }
        }
    }

    /// The state, where it allows commands; what else it may be as an error.
    async fn require_ready(&mut self) -> Result<()> {
        let status = self.status().await?;
        let why = match status.state {
            State::Ready => return Ok(()),
            State::Moving | State::Homing => (ErrorKind::Busy, "it moves".to_owned()),
            State::Jogging => (ErrorKind::Busy, "somebody moves it from the keypad".to_owned()),
            State::Configuration => {
                (ErrorKind::Busy, "it is being configured; leave that with the vendor's program".to_owned())
            }
            State::Disabled => (ErrorKind::Broken, "it was disabled; open the axis again".to_owned()),
            State::NotReferenced => {
                let had = std::mem::replace(&mut self.referenced, false);
                let kind = if had { ErrorKind::Broken } else { ErrorKind::Refused };
                let cause = if status.errors == 0 { "restart or fault".to_owned() } else { status.words().join(", ") };
                let what = if had {
                    format!("it lost its reference ({cause}); open and home the axis again")
                } else {
                    "the axis has no reference; home it first".to_owned()
                };
                (kind, what)
            }
        };
        Err(self.error(why.0, why.1))
    }

    /// Writes speed and acceleration where they differ; a box without reference does not take them.
    async fn write_speeds(&mut self) -> Result<()> {
        let (v, a) = (self.config.speed.0, self.config.acceleration_deg_per_s2);
        for (query, order, value) in
            [(Query::Velocity, Order::Velocity(v), v), (Query::Acceleration, Order::Acceleration(a), a)]
        {
            let same = |read: f64| (read - value).abs() <= SAME * value;
            if same(self.number(query).await?) {
                continue;
            }
            self.order(order, &format!("setting {value} was rejected")).await?;
            let applied = self.number(query).await?;
            if !same(applied) {
                let what = format!(
                    "`{}` is {applied} after `{order}`; lower speed or acceleration in the instrument file",
                    query.words()
                );
                return Err(self.error(ErrorKind::Refused, what));
            }
        }
        Ok(())
    }

    /// Polls until the box neither moves nor homes; stops it and gives `Broken` after `limit`.
    async fn wait_still(&mut self, limit: Duration) -> Result<Status> {
        let deadline = self.clock.now() + limit;
        loop {
            let status = self.status().await?;
            if !matches!(status.state, State::Moving | State::Homing | State::Jogging) {
                return Ok(status);
            }
            if self.clock.now() > deadline {
                self.order(Order::Stop, "stopping").await?;
                let what = format!(
                    "still moving after {:.1} s, stopped; check that nothing blocks the stage",
                    limit.as_secs_f64()
                );
                return Err(self.error(ErrorKind::Broken, what));
            }
            self.clock.sleep(POLL).await;
        }
    }

    fn check_target(&self, target: Degrees) -> Result<()> {
        if let Some(what) = self.config.beyond(target) {
            return Err(self.error(ErrorKind::Refused, what));
        }
        let (left, right) = self.opened()?;
        if target.0 < left || target.0 > right {
            let what = format!("{target} is outside the controller's own limits {left}° to {right}°; nothing was sent");
            return Err(self.error(ErrorKind::Refused, what));
        }
        Ok(())
    }

    async fn ensure(&self) -> Result<String> {
        let address = self.config.device;
        let request = format!("{address}{}", Query::Version.words());
        let mut wire = self.wire().await?;
        if !wire.alive().await {
            wire.connect().await.map_err(|e| self.own(e))?;
        }
        let line = wire.agreed(&request, |l| Query::Version.value(address, l).map(|_| l.to_owned())).await;
        let line = line.map_err(|e| self.own(e))?;
        wire.trust(NoOp { request, answer: line.clone() });
        Ok(Query::Version.value(address, &line).unwrap_or_default())
    }

    async fn stop_and_wait(&mut self) -> Result<()> {
        let status = self.status().await?;
        if matches!(status.state, State::Moving | State::Homing | State::Jogging) {
            self.order(Order::Stop, "stopping").await?;
        }
        let ramp = self.config.speed.0 / self.config.acceleration_deg_per_s2.max(1e-3);
        self.wait_still(MOVE_MARGIN + Duration::try_from_secs_f64(ramp).unwrap_or_default()).await.map(|_| ())
    }
}

#[async_trait]
impl Device for Smc100Axis {
    async fn open(&mut self) -> Result<Identity> {
        self.limits = None;
        let firmware = self.ensure().await?;
        if !firmware.contains("SMC100") {
            let what = format!("it says {firmware:?}, a Newport SMC100 is needed; correct `port`");
            return Err(self.error(ErrorKind::WrongDevice, what));
        }
        let stage = self.ask(Query::StageId, Some).await?;
        let wanted = &self.config.serial;
        if !stage.split(|c: char| !c.is_ascii_alphanumeric()).any(|word| word == wanted) && stage != *wanted {
            let what = format!(
                "box {} has the stage {stage}, the instrument file says {wanted}; its calibration is void: connect the right stage or correct `serial`",
                self.config.device
            );
            return Err(self.error(ErrorKind::WrongDevice, what));
        }
        let limits = (self.number(Query::LeftLimit).await?, self.number(Query::RightLimit).await?);
        if self.status().await?.state == State::Disabled {
            self.order(Order::Enable, "enabling").await?;
        }
        let state = self.status().await?.state;
        self.referenced = matches!(state, State::Ready | State::Moving);
        if state == State::Ready {
            self.write_speeds().await?;
        }
        self.limits = Some(limits);
        let serial = self.config.serial.clone();
        Ok(Identity { model: format!("Newport SMC100, {stage}"), firmware, serial })
    }

    async fn health(&mut self) -> Result<Health> {
        self.opened()?;
        let status = self.status().await?;
        let mut warnings = status.words();
        if status.state == State::NotReferenced {
            self.referenced = false;
            warnings.push("no reference".to_owned());
        }
        let unasked = self.wire().await?.unsolicited;
        if unasked > 0 {
            warnings.push(format!("{unasked} times bytes came unasked"));
        }
        Ok(Health { warnings, temperature_c: None })
    }

    async fn make_safe(&mut self) -> Result<()> {
        self.ensure().await?;
        self.stop_and_wait().await
    }
}

#[async_trait]
impl RotaryAxis for Smc100Axis {
    fn limits(&self) -> (Degrees, Degrees) {
        (self.config.min, self.config.max)
    }

    fn speed(&self) -> (DegreesPerSecond, f64) {
        (self.config.speed, self.config.acceleration_deg_per_s2)
    }

    /// A box that has its reference keeps it: only a restart would let it search again.
    async fn home(&mut self) -> Result<()> {
        self.opened()?;
        let limit = Duration::try_from_secs_f64(self.number(Query::HomeLimit).await?).unwrap_or_default();
        let state = self.status().await?.state;
        if state == State::NotReferenced {
            let sure = self.order(Order::Home, "homing failed").await?;
            // Sent once more only when its fate is unknown and the box is seen not to search.
            if !sure && self.status().await?.state == State::NotReferenced {
                self.order(Order::Home, "homing failed").await?;
            }
        }
        let status = self.wait_still(limit + Duration::from_secs(5)).await?;
        if status.state == State::NotReferenced {
            let what = format!("homing failed: {}; check stage and cable", status.words().join(", "));
            return Err(self.error(ErrorKind::Broken, what));
        }
        self.require_ready().await?;
        self.referenced = true;
        self.write_speeds().await?;
        self.clock.sleep(self.config.settle).await;
        Ok(())
    }

    async fn move_to(&mut self, target: Degrees) -> Result<Degrees> {
        self.check_target(target)?;
        self.require_ready().await?;
        let mut reached = Degrees(self.number(Query::Position).await?);
        let mut wrong = None;
        for _ in 0..MOVE_TRIES {
            self.order(Order::MoveAbs(target.0), &format!("the move to {target} was refused")).await?;
            self.wait_still(self.config.travel(reached.distance(target)) + MOVE_MARGIN).await?;
            self.require_ready().await?;
            self.clock.sleep(self.config.settle).await;
            reached = Degrees(self.number(Query::Position).await?);
            wrong = self.config.missed(target, reached);
            if wrong.is_none() {
                return Ok(reached);
            }
        }
        Err(self.error(ErrorKind::Broken, wrong.unwrap_or_default()))
    }

    async fn position(&mut self) -> Result<Option<Degrees>> {
        self.opened()?;
        let state = self.status().await?.state;
        self.referenced &= !matches!(state, State::NotReferenced | State::Configuration | State::Homing);
        let known = matches!(state, State::Ready | State::Disabled);
        let at = self.number(Query::Position).await?;
        Ok((known && self.referenced).then_some(Degrees(at)))
    }

    async fn stop(&mut self) -> Result<()> {
        self.stop_and_wait().await?;
        self.number(Query::Position).await.map(|_| ())
    }
}
