//! Driver `zaber-ascii`: rotary stages and controllers that speak the Zaber ASCII protocol (firmware 6.14 to 7.x).
//!
//! An axis is trusted only after `open` has proven its serial number and `home` its reference. Evidence of a restart
//! (uptime went back, reference gone) makes every later move fail until the axis is opened and homed again.

use super::AxisConfig;
use super::zaber_chain::Shared;
use super::zaber_protocol::{Address, Command, Reply, Setting};
use super::zaber_warning::{Class, Warning};
use crate::contract::{Device, Health, Identity, RotaryAxis};
use crate::error::{DeviceError, ErrorKind, Result};
use crate::units::{Degrees, DegreesPerSecond};
use async_trait::async_trait;
use std::time::Duration;

/// Poll interval while the axis moves.
const POLL: Duration = Duration::from_millis(50);
/// Added to every computed travel time.
const MOVE_MARGIN: Duration = Duration::from_secs(3);
/// Units of `maxspeed` in a microstep a second.
const SPEED_UNITS: f64 = 1.6384;
/// Units of `accel` in a microstep a second squared.
const ACCEL_UNITS: f64 = 1.6384e-4;

/// One axis of a chain.
pub struct ZaberAxis {
    shared: Shared,
    config: AxisConfig,
    label: String,
    scale: Option<Scale>,
    uptime: Option<f64>,
}

/// What the device says about its geometry; known after `open`.
#[derive(Debug, Clone, Copy)]
struct Scale {
    microsteps_per_turn: f64,
    min: i64,
    max: i64,
    approach_deg_per_s: f64,
}

// === impl Scale ===

impl Scale {
    fn microsteps(&self, angle: Degrees) -> i64 {
        (angle.0 * self.microsteps_per_turn / 360.0).round() as i64
    }

    fn degrees(&self, microsteps: i64) -> Degrees {
        Degrees(microsteps as f64 * 360.0 / self.microsteps_per_turn)
    }
}

// === impl ZaberAxis ===

impl ZaberAxis {
    pub(super) fn new(shared: Shared, config: AxisConfig) -> ZaberAxis {
        let label = format!("{} ({})", config.name, shared.port);
        ZaberAxis { shared, config, label, scale: None, uptime: None }
    }

    fn error(&self, kind: ErrorKind, message: impl Into<String>) -> DeviceError {
        DeviceError::new(kind, &self.label, message)
    }

    fn own(&self, error: DeviceError) -> DeviceError {
        self.error(error.kind, error.message)
    }

    fn scale(&self) -> Result<Scale> {
        self.scale.ok_or_else(|| self.error(ErrorKind::Lost, "the axis is not open; open it first"))
    }

    /// Reply of device (`axis` 0) or axis, accepted or rejected.
    async fn ask_at(&self, axis: u8, command: Command) -> Result<Reply> {
        let at = Address { device: self.config.device, axis };
        let asked = match self.shared.wire().await {
            Ok(mut wire) => wire.ask(at, command).await,
            Err(error) => Err(error),
        };
        asked.map_err(|error| self.own(error))
    }

    /// Reply of the axis; a rejection is an error.
    async fn ask(&self, command: Command) -> Result<Reply> {
        let reply = self.ask_at(self.config.axis, command).await?;
        if reply.accepted { Ok(reply) } else { Err(self.rejected(command, &reply.data)) }
    }

    /// A setting of device (`axis` 0) or axis as text; `None` when the device does not know it.
    async fn setting(&self, axis: u8, setting: Setting) -> Result<Option<String>> {
        let reply = self.ask_at(axis, Command::Get(setting)).await?;
        match (reply.accepted, reply.data.as_str()) {
            (true, _) => Ok(Some(reply.data)),
            (false, "BADCOMMAND") => Ok(None),
            (false, why) => Err(self.rejected(Command::Get(setting), why)),
        }
    }

    /// A number of the axis that must be there.
    async fn number(&self, setting: Setting) -> Result<f64> {
        let text = self.setting(self.config.axis, setting).await?;
        let value = text.as_deref().and_then(|t| t.trim().parse::<f64>().ok()).filter(|v| v.is_finite());
        value.ok_or_else(|| {
            let what = format!(
                "the axis gives {text:?} for {}, a number is needed; it is not a usable rotary stage",
                setting.name()
            );
            self.error(ErrorKind::WrongDevice, what)
        })
    }

    fn rejected(&self, command: Command, word: &str) -> DeviceError {
        let (kind, hint) = match word {
            "BADDATA" => (ErrorKind::Refused, "a value is out of its range"),
            "STATUSBUSY" => (ErrorKind::Busy, "it moves, or a fault is latched"),
            "AGAIN" | "FULL" => (ErrorKind::Busy, "it asks to try later"),
            "PARKED" => (ErrorKind::Refused, "it is parked"),
            "DRIVERDISABLED" => (ErrorKind::Broken, "the drive stage is off; open and home the axis again"),
            "BADAXIS" => (ErrorKind::WrongDevice, "it has no such axis; check `axis` in the instrument file"),
            "LOCKSTEP" => {
                (ErrorKind::Refused, "the axis belongs to a lockstep group; undo it with the vendor's program")
            }
            "BADCOMMAND" | "NOACCESS" => (ErrorKind::Refused, "model, firmware or access level does not allow it"),
            _ => (ErrorKind::Refused, "see the device's manual"),
        };
        self.error(kind, format!("the device rejected `{command}` with {word}: {hint}"))
    }

    /// Checksums on (read first: the setting may live in flash), alerts off.
    async fn prepare_link(&self) -> Result<()> {
        match self.setting(0, Setting::Checksum).await?.as_deref().map(str::trim) {
            Some("1") => {}
            Some(_) => {
                let reply = self.ask_at(0, Command::ChecksumOn).await?;
                if !reply.accepted {
                    return Err(self.rejected(Command::ChecksumOn, &reply.data));
                }
            }
            None => {
                let what = "the firmware has no checksums (older than 6.14); update it with the vendor's program";
                return Err(self.error(ErrorKind::WrongDevice, what));
            }
        }
        self.shared.wire().await?.checked.insert(self.config.device);
        if self.setting(0, Setting::Alert).await?.as_deref().map(str::trim) == Some("1") {
            self.ask_at(0, Command::AlertsOff).await?;
        }
        Ok(())
    }

    /// Reads model, firmware and serial number, and compares the last with the configuration.
    async fn identify(&self) -> Result<Identity> {
        let model = match self.setting(0, Setting::DeviceId).await? {
            Some(id) => id,
            None => self.setting(0, Setting::DeviceIdFirmware6).await?.unwrap_or_default(),
        };
        let firmware = self.setting(0, Setting::Version).await?.unwrap_or_default();
        let mut serial = self.setting(0, Setting::SystemSerial).await?.unwrap_or_default();
        if serial != self.config.serial
            && let Some(stage) = self.setting(self.config.axis, Setting::PeripheralSerial).await?
            && stage == self.config.serial
        {
            serial = stage;
        }
        if serial != self.config.serial {
            let what = format!(
                "device {} has serial number {serial}, the instrument file says {}; its calibration is void: connect the right stage or correct `serial`",
                self.config.device, self.config.serial
            );
            return Err(self.error(ErrorKind::WrongDevice, what));
        }
        Ok(Identity { model: format!("Zaber {model}"), firmware, serial })
    }

    /// Reads the geometry, writes speed and acceleration where they differ and reads them back.
    async fn read_scale(&self) -> Result<Scale> {
        let turn = self.number(Setting::CycleDist).await?;
        if turn < 1.0 {
            return Err(self
                .error(ErrorKind::WrongDevice, "the axis has no turn (limit.cycle.dist 0); it is not a rotary stage"));
        }
        let speed = (self.config.speed.0 * turn / 360.0 * SPEED_UNITS).round();
        let accel = (self.config.acceleration_deg_per_s2 * turn / 360.0 * ACCEL_UNITS).round().max(1.0);
        self.write(Setting::MaxSpeed, Command::SetMaxSpeed(speed as u64), speed).await?;
        self.write(Setting::Accel, Command::SetAccel(accel as u64), accel).await?;
        let approach = match self.setting(self.config.axis, Setting::ApproachSpeed).await? {
            Some(text) => text.trim().parse::<f64>().ok().filter(|v| *v > 0.0).unwrap_or(speed),
            None => speed,
        };
        Ok(Scale {
            microsteps_per_turn: turn,
            min: self.number(Setting::LimitMin).await? as i64,
            max: self.number(Setting::LimitMax).await? as i64,
            approach_deg_per_s: approach.min(speed) / SPEED_UNITS * 360.0 / turn,
        })
    }

    async fn write(&self, setting: Setting, command: Command, value: f64) -> Result<()> {
        if self.number(setting).await? == value {
            return Ok(());
        }
        self.ask(command).await?;
        let applied = self.number(setting).await?;
        if applied == value {
            Ok(())
        } else {
            let what = format!(
                "{} is {applied} after `{command}`; lower speed or acceleration in the instrument file",
                setting.name()
            );
            Err(self.error(ErrorKind::Refused, what))
        }
    }

    /// All warnings of the axis, also those a reply does not show.
    async fn warnings(&self) -> Result<Vec<Warning>> {
        let reply = self.ask(Command::Warnings).await?;
        Warning::list(&reply.data)
            .ok_or_else(|| self.error(ErrorKind::Garbled, format!("`{}` is no list of warnings", reply.data)))
    }

    /// `Broken` when the device was restarted since the last look; opening takes a new start.
    async fn check_uptime(&mut self) -> Result<()> {
        let Some(before) = self.uptime else { return Ok(()) };
        let now = self.setting(0, Setting::Uptime).await?.and_then(|t| t.trim().parse::<f64>().ok());
        match now {
            Some(now) if now < before => Err(self.restarted()),
            _ => {
                self.uptime = now.or(self.uptime);
                Ok(())
            }
        }
    }

    fn restarted(&mut self) -> DeviceError {
        self.scale = None;
        self.uptime = None;
        self.error(
            ErrorKind::Broken,
            "the device was restarted, its position means nothing; open and home the axis again",
        )
    }

    /// Polls until the axis stands; `Broken` after `limit`, with the axis stopped.
    async fn wait_idle(&self, limit: Duration) -> Result<Reply> {
        let deadline = self.shared.clock.now() + limit;
        loop {
            let reply = self.ask(Command::Poll).await?;
            if !reply.busy {
                return Ok(reply);
            }
            if self.shared.clock.now() > deadline {
                self.ask(Command::Stop).await?;
                let what = format!(
                    "still moving after {:.1} s, stopped; check that nothing blocks the stage",
                    limit.as_secs_f64()
                );
                return Err(self.error(ErrorKind::Broken, what));
            }
            self.shared.clock.sleep(POLL).await;
        }
    }

    async fn read_microsteps(&self) -> Result<i64> {
        Ok(self.number(Setting::Position).await?.round() as i64)
    }

    /// The target in microsteps, or why it may not be commanded.
    fn check_target(&self, target: Degrees) -> Result<i64> {
        if let Some(what) = self.config.beyond(target) {
            return Err(self.error(ErrorKind::Refused, what));
        }
        let scale = self.scale()?;
        let steps = scale.microsteps(target);
        if steps < scale.min || steps > scale.max {
            let (low, high) = (scale.degrees(scale.min), scale.degrees(scale.max));
            let what = format!("{target} is outside the device's own limits {low} to {high}; nothing was sent");
            return Err(self.error(ErrorKind::Refused, what));
        }
        Ok(steps)
    }

    /// Sends the motion; a parked axis is unparked once.
    async fn start_move(&self, steps: i64) -> Result<()> {
        let command = Command::MoveAbs(steps);
        let mut reply = self.ask_at(self.config.axis, command).await?;
        if !reply.accepted && reply.data == "PARKED" {
            self.ask(Command::Unpark).await?;
            reply = self.ask_at(self.config.axis, command).await?;
        }
        if reply.accepted { Ok(()) } else { Err(self.rejected(command, &reply.data)) }
    }

    /// Sends `home`. A lost reply is not repeated blindly: the status tells whether the axis moves; only an axis that
    /// stands is told once more.
    async fn start_home(&self) -> Result<()> {
        match self.ask(Command::Home).await {
            Err(error) if matches!(error.kind, ErrorKind::Timeout | ErrorKind::Garbled) => {
                if self.ask(Command::Poll).await?.busy {
                    return Ok(());
                }
                self.ask(Command::Home).await.map(|_| ())
            }
            Err(error) if error.message.contains("PARKED") => {
                self.ask(Command::Unpark).await?;
                self.ask(Command::Home).await.map(|_| ())
            }
            other => other.map(|_| ()),
        }
    }

    async fn stop_and_wait(&self) -> Result<()> {
        self.ask(Command::Stop).await?;
        let ramp = self.config.speed.0 / self.config.acceleration_deg_per_s2.max(1e-3);
        let limit = MOVE_MARGIN + Duration::try_from_secs_f64(ramp).unwrap_or_default();
        self.wait_idle(limit).await.map(|_| ())
    }
}

#[async_trait]
impl Device for ZaberAxis {
    async fn open(&mut self) -> Result<Identity> {
        self.scale = None;
        self.uptime = None;
        let linked = self.shared.wire().await?.ensure(self.config.device).await;
        linked.map_err(|error| self.own(error))?;
        self.prepare_link().await?;
        let identity = self.identify().await?;
        let warnings = self.warnings().await?;
        if warnings.iter().any(|w| w.class == Class::DriveOff) {
            self.ask(Command::DriverEnable).await?;
        }
        let scale = self.read_scale().await?;
        self.uptime = self.setting(0, Setting::Uptime).await?.and_then(|t| t.trim().parse().ok());
        self.scale = Some(scale);
        Ok(identity)
    }

    async fn health(&mut self) -> Result<Health> {
        self.scale()?;
        self.check_uptime().await?;
        let warnings = self.warnings().await?.iter().map(Warning::words).collect();
        let text = match self.setting(self.config.axis, Setting::DriverTemperature).await? {
            Some(text) => Some(text),
            None => self.setting(0, Setting::SystemTemperature).await?,
        };
        let temperature_c = text.and_then(|t| t.trim().parse().ok());
        Ok(Health { warnings, temperature_c })
    }

    async fn make_safe(&mut self) -> Result<()> {
        let linked = self.shared.wire().await?.ensure(self.config.device).await;
        linked.map_err(|error| self.own(error))?;
        self.stop_and_wait().await
    }
}

#[async_trait]
impl RotaryAxis for ZaberAxis {
    fn limits(&self) -> (Degrees, Degrees) {
        (self.config.min, self.config.max)
    }

    fn speed(&self) -> (DegreesPerSecond, f64) {
        (self.config.speed, self.config.acceleration_deg_per_s2)
    }

    async fn home(&mut self) -> Result<()> {
        let scale = self.scale()?;
        self.check_uptime().await?;
        let before = self.warnings().await?;
        if let Some(bad) = before.iter().find(|w| !w.allows_home()) {
            return Err(self.error(ErrorKind::Broken, format!("cannot home: {}", bad.words())));
        }
        if before.iter().any(|w| w.class == Class::PositionLost) {
            self.ask(Command::ClearWarnings).await?;
        }
        self.start_home().await?;
        let limit = Duration::try_from_secs_f64(360.0 / scale.approach_deg_per_s * 1.5).unwrap_or(MOVE_MARGIN);
        self.wait_idle(limit + Duration::from_secs(5)).await?;
        self.check_uptime().await?;
        let after = self.warnings().await?;
        match after.iter().find(|w| w.fails_move()) {
            Some(bad) => Err(self.error(ErrorKind::Broken, format!("homing failed: {}", bad.words()))),
            None => {
                self.shared.clock.sleep(self.config.settle).await;
                Ok(())
            }
        }
    }

    async fn move_to(&mut self, target: Degrees) -> Result<Degrees> {
        let steps = self.check_target(target)?;
        let scale = self.scale()?;
        self.check_uptime().await?;
        for warning in self.warnings().await? {
            if let Some(kind) = warning.forbids_move() {
                return Err(self.error(kind, format!("cannot move: {}", warning.words())));
            }
        }
        let from = scale.degrees(self.read_microsteps().await?);
        self.start_move(steps).await?;
        self.wait_idle(self.config.travel(from.distance(target)) + MOVE_MARGIN).await?;
        self.shared.clock.sleep(self.config.settle).await;
        let reached = scale.degrees(self.read_microsteps().await?);
        let after = self.warnings().await?;
        if after.iter().any(|w| w.class == Class::Unreferenced) {
            return Err(self.restarted());
        }
        self.check_uptime().await?;
        if let Some(bad) = after.iter().find(|w| w.fails_move()) {
            return Err(self.error(ErrorKind::Broken, format!("the move to {target} failed: {}", bad.words())));
        }
        match self.config.missed(target, reached) {
            None => Ok(reached),
            Some(what) => Err(self.error(ErrorKind::Broken, what)),
        }
    }

    async fn position(&mut self) -> Result<Option<Degrees>> {
        let scale = self.scale()?;
        self.check_uptime().await?;
        let void = self.warnings().await?.iter().any(Warning::voids_position);
        let steps = self.read_microsteps().await?;
        Ok((!void).then(|| scale.degrees(steps)))
    }

    async fn stop(&mut self) -> Result<()> {
        self.stop_and_wait().await?;
        self.read_microsteps().await.map(|_| ())
    }
}
