//! Driver `newport-esp301`: rotation stages on a Newport ESP300 or ESP301, all axes on one controller.
//!
//! The controller does not tell whether an axis was homed. An axis is trusted after `home` in this driver's life, as
//! long as its motor stays on: motors are off after power-up, after a fault and after an emergency stop.

use super::AxisConfig;
use super::esp301_bus::{Shared, Told};
use super::esp301_protocol::{DEGREES, Order, Query, Report, stage_id};
use crate::contract::{Device, Health, Identity, RotaryAxis};
use crate::error::{DeviceError, ErrorKind, Result};
use crate::units::{Degrees, DegreesPerSecond};
use async_trait::async_trait;
use std::time::Duration;

/// The USB serial port of an ESP301.
pub const BAUD: u32 = 921_600;
/// The RS-232 line of an ESP300 or ESP301, fixed.
pub const BAUD_RS232: u32 = 19_200;
/// Poll interval while an axis moves.
const POLL: Duration = Duration::from_millis(100);
/// Polls at rest that end a home search, and the time between them: between the phases of a search the axis may
/// seem to rest for a moment.
const HOME_RESTS: u32 = 3;
const HOME_POLL: Duration = Duration::from_millis(200);
/// Added to every computed travel time.
const MOVE_MARGIN: Duration = Duration::from_secs(3);
/// Times that a position is commanded before a wrong place is a fault.
const MOVE_TRIES: u32 = 2;
/// Relative difference at which a read-back speed is still the one written.
const SAME: f64 = 1e-3;

/// One axis of a controller.
pub struct Esp301Axis {
    shared: Shared,
    config: AxisConfig,
    label: String,
    limits: Option<DeviceLimits>,
    referenced: bool,
    /// The last proven position, while nothing was commanded since.
    stands: Option<f64>,
}

/// What the controller says about the stage; known after `open`.
#[derive(Debug, Clone, Copy)]
struct DeviceLimits {
    left: f64,
    right: f64,
    home_speed: f64,
}

// === impl Esp301Axis ===

impl Esp301Axis {
    pub(super) fn new(shared: Shared, config: AxisConfig) -> Esp301Axis {
        let label = format!("{} ({})", config.name, shared.port);
        Esp301Axis { shared, config, label, limits: None, referenced: false, stands: None }
    }

    fn error(&self, kind: ErrorKind, message: impl Into<String>) -> DeviceError {
        DeviceError::new(kind, &self.label, message)
    }

    fn own(&self, error: DeviceError) -> DeviceError {
        self.error(error.kind, error.message)
    }

    fn opened(&self) -> Result<DeviceLimits> {
        self.limits.ok_or_else(|| self.error(ErrorKind::Refused, "the axis is not open; open it first"))
    }

    async fn order(&self, order: Order) -> Result<Told> {
        let told = match self.shared.bus().await {
            Ok(mut bus) => bus.order(self.config.axis, order).await,
            Err(error) => Err(error),
        };
        told.map_err(|e| self.own(e))
    }

    async fn reports(&self) -> Result<Told> {
        let told = match self.shared.bus().await {
            Ok(mut bus) => bus.reports(self.config.axis).await,
            Err(error) => Err(error),
        };
        told.map_err(|e| self.own(e))
    }

    async fn number(&self, query: Query) -> Result<f64> {
        let number = match self.shared.bus().await {
            Ok(mut bus) => bus.number(self.config.axis, query).await,
            Err(error) => Err(error),
        };
        number.map_err(|e| self.own(e))
    }

    async fn flag(&self, query: Query) -> Result<bool> {
        let flag = match self.shared.bus().await {
            Ok(mut bus) => bus.flag(self.config.axis, query).await,
            Err(error) => Err(error),
        };
        flag.map_err(|e| self.own(e))
    }

    /// The first report as an error of what was being done; a fault of the axis voids its reference.
    fn fail_on(&mut self, told: &Told, doing: &str) -> Result<()> {
        let Some(Report(code)) = told.reports.first().copied() else { return Ok(()) };
        let (kind, what) = Report(code).meaning();
        if kind == ErrorKind::Broken {
            self.referenced = false;
        }
        Err(self.error(kind, format!("{doing}: error {code}, {what}")))
    }

    /// `Broken` when the motor is off: restart, fault or emergency stop. The reference is void then.
    async fn check_motor(&mut self) -> Result<()> {
        if self.flag(Query::Motor).await? {
            return Ok(());
        }
        self.referenced = false;
        let told = self.reports().await?;
        self.fail_on(&told, "the motor is off")?;
        let what = "the motor is off without our doing (restart or emergency stop), the position means nothing; open and home the axis again";
        Err(self.error(ErrorKind::Broken, what))
    }

    async fn identify(&self) -> Result<(String, String)> {
        let line = match self.shared.bus().await {
            Ok(mut bus) => bus.query(self.config.axis, Query::StageId, |line| Some(line.to_owned())).await,
            Err(error) => Err(error),
        };
        let line = line.map_err(|e| self.own(e))?;
        let wanted = self.config.serial.trim_start_matches("SN");
        let Some((model, serial)) = stage_id(&line) else {
            let what = format!(
                "axis {} has a stage that the controller does not know ({line}), a stage with serial number {wanted} is needed; check the stage cable",
                self.config.axis
            );
            return Err(self.error(ErrorKind::WrongDevice, what));
        };
        if serial != wanted {
            let what = format!(
                "axis {} has serial number {serial}, the instrument file says {wanted}; its calibration is void: connect the right stage or correct `serial`",
                self.config.axis
            );
            return Err(self.error(ErrorKind::WrongDevice, what));
        }
        Ok((model, serial))
    }

    /// Writes a speed or acceleration where it differs and reads it back.
    async fn write(&mut self, query: Query, order: Order, value: f64) -> Result<()> {
        let same = |read: f64| (read - value).abs() <= SAME * value;
        if same(self.number(query).await?) {
            return Ok(());
        }
        let told = self.order(order).await?;
        self.fail_on(&told, &format!("setting {value} was rejected"))?;
        let applied = self.number(query).await?;
        if same(applied) {
            return Ok(());
        }
        let what = format!(
            "`{}` is {applied} after `{order}`; lower speed or acceleration in the instrument file",
            query.words()
        );
        Err(self.error(ErrorKind::Refused, what))
    }

    async fn read_limits(&mut self) -> Result<DeviceLimits> {
        let units = self.number(Query::Units).await?;
        if units != f64::from(DEGREES) {
            let what = format!(
                "the axis counts in units {units}, degrees ({DEGREES}) are needed; set them with the vendor's program"
            );
            return Err(self.error(ErrorKind::WrongDevice, what));
        }
        let fastest = self.number(Query::VelocityMax).await?;
        if self.config.speed.0 > fastest {
            let what = format!(
                "{} degrees a second are faster than the stage's {fastest}; lower `speed_deg_per_s`",
                self.config.speed.0
            );
            return Err(self.error(ErrorKind::Refused, what));
        }
        let (v, a) = (self.config.speed.0, self.config.acceleration_deg_per_s2);
        self.write(Query::Velocity, Order::Velocity(v), v).await?;
        self.write(Query::Acceleration, Order::Acceleration(a), a).await?;
        self.write(Query::Deceleration, Order::Deceleration(a), a).await?;
        Ok(DeviceLimits {
            left: self.number(Query::LeftLimit).await?,
            right: self.number(Query::RightLimit).await?,
            home_speed: self.number(Query::HomeSpeed).await?,
        })
    }

    /// Polls until the axis rests for `rests` polls in a row; stops it and gives `Broken` after `limit`.
    async fn wait_done(&self, limit: Duration, rests: u32, poll: Duration) -> Result<()> {
        let deadline = self.shared.clock.now() + limit;
        let mut seen = 0;
        loop {
            seen = if self.flag(Query::Done).await? { seen + 1 } else { 0 };
            if seen >= rests {
                return Ok(());
            }
            if self.shared.clock.now() > deadline {
                self.order(Order::Stop).await?;
                let what = format!(
                    "still moving after {:.1} s, stopped; check that nothing blocks the stage",
                    limit.as_secs_f64()
                );
                return Err(self.error(ErrorKind::Broken, what));
            }
            self.shared.clock.sleep(poll).await;
        }
    }

    /// Why the target may not be commanded.
    fn check_target(&self, target: Degrees) -> Result<()> {
        if let Some(what) = self.config.beyond(target) {
            return Err(self.error(ErrorKind::Refused, what));
        }
        let device = self.opened()?;
        if target.0 < device.left || target.0 > device.right {
            let what = format!(
                "{target} is outside the controller's own limits {}° to {}°; nothing was sent",
                device.left, device.right
            );
            return Err(self.error(ErrorKind::Refused, what));
        }
        if !self.referenced {
            return Err(self.error(ErrorKind::Broken, "the axis has no reference; home it first"));
        }
        Ok(())
    }

    async fn stop_and_wait(&mut self) -> Result<()> {
        self.stands = None;
        self.order(Order::Stop).await?;
        let ramp = self.config.speed.0 / self.config.acceleration_deg_per_s2.max(1e-3);
        let limit = MOVE_MARGIN + Duration::try_from_secs_f64(ramp).unwrap_or_default();
        self.wait_done(limit, 1, POLL).await
    }

    /// Sends the search; it is sent once more only when its fate is unknown and the axis is seen to stand.
    async fn start_home(&mut self) -> Result<()> {
        for again in [false, true] {
            let told = self.order(Order::Home).await?;
            self.fail_on(&told, "homing failed")?;
            if told.certain || again || !self.flag(Query::Done).await? {
                break;
            }
        }
        Ok(())
    }
}

#[async_trait]
impl Device for Esp301Axis {
    async fn open(&mut self) -> Result<Identity> {
        self.limits = None;
        let linked = self.shared.bus().await?.ensure().await;
        let firmware = linked.map_err(|e| self.own(e))?;
        let old = self.reports().await?;
        if !old.reports.is_empty() {
            tracing::info!(device = self.label, reports = ?old.reports, "reports from before");
        }
        let (model, serial) = self.identify().await?;
        let limits = self.read_limits().await?;
        let on = self.flag(Query::Motor).await?;
        let stands = self.number(Query::Position).await?;
        let moved = self.stands.is_some_and(|was| (was - stands).abs() > self.config.tolerance.0);
        self.referenced &= on && !moved;
        self.limits = Some(limits);
        Ok(Identity { model: format!("Newport {model}"), firmware, serial })
    }

    async fn health(&mut self) -> Result<Health> {
        self.opened()?;
        let told = self.reports().await?;
        let mut warnings: Vec<String> =
            told.reports.iter().map(|r| format!("error {}: {}", r.0, r.meaning().1)).collect();
        if !self.flag(Query::Motor).await? {
            self.referenced = false;
            warnings.push("motor off".to_owned());
        }
        if !self.referenced {
            warnings.push("no reference".to_owned());
        }
        let unasked = self.shared.bus().await?.wire.unsolicited;
        if unasked > 0 {
            warnings.push(format!("{unasked} times bytes came unasked"));
        }
        Ok(Health { warnings, temperature_c: None })
    }

    async fn make_safe(&mut self) -> Result<()> {
        let linked = self.shared.bus().await?.ensure().await;
        linked.map_err(|e| self.own(e))?;
        self.stop_and_wait().await
    }
}

#[async_trait]
impl RotaryAxis for Esp301Axis {
    fn limits(&self) -> (Degrees, Degrees) {
        (self.config.min, self.config.max)
    }

    fn speed(&self) -> (DegreesPerSecond, f64) {
        (self.config.speed, self.config.acceleration_deg_per_s2)
    }

    async fn home(&mut self) -> Result<()> {
        let device = self.opened()?;
        self.referenced = false;
        self.stands = None;
        self.reports().await?;
        let told = self.order(Order::MotorOn).await?;
        self.fail_on(&told, "the motor cannot be switched on")?;
        self.start_home().await?;
        let turn = 360.0 / device.home_speed.max(1e-3) * 1.5;
        let limit = Duration::try_from_secs_f64(turn).unwrap_or(MOVE_MARGIN) + Duration::from_secs(10);
        self.wait_done(limit, HOME_RESTS, HOME_POLL).await?;
        let told = self.reports().await?;
        self.fail_on(&told, "homing failed")?;
        self.check_motor().await?;
        self.shared.clock.sleep(self.config.settle).await;
        let (preset, at) = (self.number(Query::HomePreset).await?, self.number(Query::Position).await?);
        if (at - preset).abs() > self.config.tolerance.0 {
            let what =
                format!("after homing the axis stands at {at}° instead of its home position {preset}°; home it again");
            return Err(self.error(ErrorKind::Broken, what));
        }
        self.referenced = true;
        self.stands = Some(at);
        Ok(())
    }

    async fn move_to(&mut self, target: Degrees) -> Result<Degrees> {
        self.check_target(target)?;
        self.check_motor().await?;
        let mut reached = Degrees(self.number(Query::Position).await?);
        let mut wrong = None;
        self.stands = None;
        for _ in 0..MOVE_TRIES {
            let told = self.order(Order::MoveAbs(target.0)).await?;
            self.fail_on(&told, &format!("the move to {target} was refused"))?;
            let limit = self.config.travel(reached.distance(target)) + MOVE_MARGIN;
            self.wait_done(limit, 1, POLL).await?;
            let told = self.reports().await?;
            self.fail_on(&told, &format!("the move to {target} failed"))?;
            self.check_motor().await?;
            self.shared.clock.sleep(self.config.settle).await;
            reached = Degrees(self.number(Query::Position).await?);
            wrong = self.config.missed(target, reached);
            if wrong.is_none() {
                self.stands = Some(reached.0);
                return Ok(reached);
            }
        }
        Err(self.error(ErrorKind::Broken, wrong.unwrap_or_default()))
    }

    async fn position(&mut self) -> Result<Option<Degrees>> {
        self.opened()?;
        if !self.flag(Query::Motor).await? {
            self.referenced = false;
        }
        let at = self.number(Query::Position).await?;
        Ok(self.referenced.then_some(Degrees(at)))
    }

    async fn stop(&mut self) -> Result<()> {
        self.stop_and_wait().await?;
        self.stands = Some(self.number(Query::Position).await?);
        Ok(())
    }
}
