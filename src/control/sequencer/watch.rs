//! Reads the gauges of the interlocks between exposures, keeps their ages, and tells what they mean together.

use super::hours::Hours;
use super::interlocks::{Gauge, Gauges, Trips, evaluate};
use super::light::{Light, LightRules};
use super::stage::Stage;
use crate::archive::RunDir;
use crate::config::night::Interlocks;
use crate::control::devices::bench::Bench;
use crate::control::events::{Event, LampNow};
use goniod_drivers::error::Result;
use std::sync::Arc;
use std::time::Duration;
use tokio::time::Instant;

/// Limit for one gauge: a question that takes longer is no answer.
const GAUGE_LIMIT: Duration = Duration::from_secs(5);

/// Limit for opening the light monitor.
const OPEN_LIMIT: Duration = Duration::from_secs(15);

/// Readings of the light monitor that a level is the mean of.
const LIGHT_READINGS: usize = 4;

/// Words of a shutter's health that tell of its interlock contact.
const CONTACT: &str = "interlock";

/// The interlocks of a run under way.
pub(super) struct Watch {
    limits: Option<Interlocks>,
    archive: Arc<RunDir>,
    gauges: Gauges,
    begun: Instant,
    due: Instant,
    told: Trips,
    /// The first level of the light monitor, of the lamp as it was struck last.
    reference: Option<f64>,
    /// Lowest and highest level since they were forgotten.
    levels: Option<(f64, f64)>,
    /// What was told of the lamp.
    lamp: Option<LampNow>,
    /// What the levels say of the lamp.
    light: Light,
    /// The hours of the lamp, where they are kept.
    hours: Option<Hours>,
    /// The light monitor is open.
    open: bool,
}

// === impl Watch ===

impl Watch {
    /// Begins to watch; nothing is read yet. Without limits nothing is ever read.
    pub(super) fn new(limits: Option<Interlocks>, rules: LightRules, archive: Arc<RunDir>, now: Instant) -> Watch {
        Watch {
            limits,
            archive,
            gauges: Gauges::default(),
            begun: now,
            due: now,
            told: Trips::default(),
            reference: None,
            levels: None,
            lamp: None,
            hours: rules.hours.clone().map(Hours::new),
            light: Light::new(rules),
            open: false,
        }
    }

    /// How often gauges are read; `None` where nothing is watched.
    pub(super) fn period(&self) -> Option<Duration> {
        self.limits.as_ref().map(Interlocks::period)
    }

    /// Largest relative change of the lamp within one bracket.
    pub(super) fn drift_per_view(&self) -> Option<f64> {
        self.limits.as_ref()?.drift_per_view
    }

    /// How long the run may stay suspended: a lamp that is out must cool and warm up besides.
    pub(super) fn longest_suspension(&self, now: Instant) -> Duration {
        self.limits.clone().unwrap_or_default().longest_suspension() + self.light.lock_out(now)
    }

    /// True where the light monitor tells whether the lamp burns and is steady.
    pub(super) fn judges_lamp(&self) -> bool {
        self.limits.is_some() && self.light.has_lamp()
    }

    /// True unless the lamp is known not to be steady.
    pub(super) fn lamp_is_steady(&self, now: Instant) -> bool {
        !self.judges_lamp() || self.light.settled(now)
    }

    /// A bracket begins.
    pub(super) fn forget_levels(&mut self) {
        self.levels = None;
    }

    /// Largest change of any level since the bracket began from the one at its beginning, relative; a lamp may have gone
    /// and come back. `None` where no level was had.
    pub(super) fn largest_change(&self, before: f64) -> Option<f64> {
        let (low, high) = self.levels.map(|(low, high)| (low / before - 1.0, high / before - 1.0))?;
        Some(if low.abs() > high.abs() { low } else { high })
    }

    /// Times the lamp was seen going out.
    pub(super) fn lamp_losses(&self) -> u32 {
        self.light.losses()
    }

    /// Reads what is due, then tells what all readings mean now; a change is recorded.
    pub(super) async fn look(&mut self, bench: &mut Bench, stage: &Stage) -> Trips {
        self.count_hours(bench, stage, false).await;
        let Some(limits) = self.limits.clone() else { return Trips::default() };
        let now = stage.clock().now();
        if now >= self.due {
            self.due = now + limits.period();
            self.read(bench, &limits, stage).await;
        }
        self.tell_lamp(stage).await;
        let trips = evaluate(&self.gauges.readings(stage.clock().now()), &limits);
        if trips != self.told {
            self.told = trips.clone();
            let Trips { warnings, alarms } = trips.clone();
            let (warnings, alarms) = (warnings.into_iter().collect(), alarms.into_iter().collect());
            stage.recorder().event(Event::Interlocks { warnings, alarms }).await;
        }
        trips
    }

    /// The run is over.
    pub(super) async fn end(&mut self, bench: &Bench, stage: &Stage) {
        self.count_hours(bench, stage, true).await;
    }

    /// Without a light monitor the lamp is taken to burn as long as the run lasts.
    async fn count_hours(&mut self, bench: &Bench, stage: &Stage, end: bool) {
        let Some(hours) = &mut self.hours else { return };
        let seen = bench.devices.light_monitor.is_some();
        let burnt = if seen { self.light.burnt() } else { stage.clock().now() - self.begun };
        hours.note(burnt, end, stage).await;
    }

    async fn read(&mut self, bench: &mut Bench, limits: &Interlocks, stage: &Stage) {
        let clock = stage.clock();
        self.note(Gauge::LampOn, Some((clock.now() - self.begun).as_secs_f64()), clock.now());
        if limits.temperature_warning_c.is_some() || limits.temperature_alarm_c.is_some() {
            for (name, camera) in &mut bench.devices.cameras {
                let health = clock.timeout(GAUGE_LIMIT, camera.health()).await;
                match flat(health) {
                    // A camera without a sensor has no temperature to watch.
                    Some(health) if health.temperature_c.is_none() => {}
                    health => {
                        let value = health.and_then(|h| h.temperature_c);
                        self.note(Gauge::Temperature(name.clone()), value, clock.now());
                    }
                }
            }
        }
        if limits.door {
            let health = flat(clock.timeout(GAUGE_LIMIT, bench.devices.shutter.health()).await);
            let open = health.map(|h| f64::from(u8::from(h.warnings.iter().any(|w| w.contains(CONTACT)))));
            self.note(Gauge::Door, open, clock.now());
        }
        if limits.free_disk_warning_mb.is_some() || limits.free_disk_alarm_mb.is_some() {
            let archive = Arc::clone(&self.archive);
            let free = tokio::task::spawn_blocking(move || archive.free()).await;
            let free_mb = free.ok().and_then(std::result::Result::ok).map(|bytes| bytes as f64 / 1e6);
            self.note(Gauge::FreeDisk, free_mb, clock.now());
        }
        // The level at the end of the warm-up is the one to compare with; a lamp is watched from the beginning.
        if self.light.has_lamp() || clock.now() - self.begun >= Duration::from_secs_f64(limits.warm_up_s.max(0.0)) {
            self.level(bench, stage, None).await;
        }
    }

    /// Reads the light monitor, where there is one, and records the level; a level that cannot be had is silence.
    /// Opened anew after each silence. Watts.
    pub(super) async fn level(&mut self, bench: &mut Bench, stage: &Stage, view: Option<u32>) -> Option<f64> {
        let clock = stage.clock();
        let monitor = bench.devices.light_monitor.as_mut()?;
        if !self.open && flat(clock.timeout(OPEN_LIMIT, monitor.open()).await).is_none() {
            self.note(Gauge::Light, None, clock.now());
            return None;
        }
        self.open = true;
        let mut powers = Vec::with_capacity(LIGHT_READINGS);
        for _ in 0..LIGHT_READINGS {
            let reading = flat(clock.timeout(GAUGE_LIMIT, monitor.read()).await);
            reading.iter().for_each(|reading| self.light.read(reading, clock.now()));
            match reading.filter(|r| !r.saturated && r.power_w.is_finite()) {
                // A lamp that is out is a level like any other; the offset of the meter may lie below zero.
                Some(reading) => powers.push(reading.power_w.max(0.0)),
                None => {
                    self.open = false;
                    self.note(Gauge::Light, None, clock.now());
                    self.note_light(clock.now());
                    return None;
                }
            }
        }
        self.note_light(clock.now());
        self.tell_lamp(stage).await;
        let n = powers.len() as f64;
        let power_w = powers.iter().sum::<f64>() / n;
        let squares: f64 = powers.iter().map(|p| (p - power_w).powi(2)).sum();
        let u_w = (squares / (n - 1.0) / n).sqrt();
        let (low, high) = self.levels.unwrap_or((power_w, power_w));
        self.levels = Some((low.min(power_w), high.max(power_w)));
        stage.recorder().event(Event::LightRead { view, power_w, u_w }).await;
        if !self.light.warm(clock.now()) {
            // Whether it burns is the lamp's own gauge; the next lamp that is struck has a level of its own.
            self.reference = None;
        } else if self.reference.is_some() || self.light.settled(clock.now()) {
            if power_w > 0.0 {
                self.reference.get_or_insert(power_w);
            }
            // Without light from the start there is nothing to compare with.
            let change = self.reference.map(|reference| power_w / reference - 1.0);
            self.note(Gauge::Light, change, clock.now());
        }
        Some(power_w)
    }

    /// Records what the lamp does, where that is new.
    async fn tell_lamp(&mut self, stage: &Stage) {
        // Where nobody waits for the lamp, what is read of it counts as it is.
        let lamp = if self.judges_lamp() { self.light.now(stage.clock()) } else { None };
        if lamp.as_ref().map(std::mem::discriminant) != self.lamp.as_ref().map(std::mem::discriminant) {
            self.lamp.clone_from(&lamp);
            if let Some(lamp) = lamp {
                stage.recorder().event(Event::Lamp { lamp }).await;
            }
        }
    }

    fn note_light(&mut self, now: Instant) {
        for (gauge, value) in self.light.gauges(now) {
            self.note(gauge, Some(value), now);
        }
    }

    fn note(&mut self, gauge: Gauge, value: Option<f64>, now: Instant) {
        match value {
            Some(value) => self.gauges.answered(gauge, value, now),
            None => self.gauges.missed(gauge, now),
        }
    }
}

/// The answer, where one came in time.
fn flat<T, E>(answer: std::result::Result<Result<T>, E>) -> Option<T> {
    answer.ok()?.ok()
}
