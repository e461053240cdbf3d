//! How long a plan takes and how much it writes: the sequencer's moves played through with the instrument's numbers.

use super::build::PlanError;
use super::{Forecast, Step, View};
use crate::config::instrument::{Axis, Camera, Instrument};
use crate::control::plan::Subject;
use goniod_drivers::frame::PixelFormat;
use goniod_drivers::units::ExposureTime;
use std::collections::BTreeMap;

/// Two commanded angles nearer than this are one pose, degrees; axes are commanded in millionths.
const SAME_DEG: f64 = 1e-7;

/// What the forecast supposes about the sequencer and the drivers, besides the numbers of the instrument file.
///
/// The model: the shutter is closed before anything turns and opened again before the next exposure with light; wheel,
/// changer, tilt and spin move one after the other; each axis motion is noticed at the next poll. A camera runs free from
/// its first exposure on, frame after frame, each as long as the larger of integration + read-out and the frame interval.
/// When it is armed, the frame under way and, after a change of exposure, `discard_frames` frames with the settings before
/// go by; where the instrument gives `restart_s`, the camera restarts its stream instead when that is shorter. Then comes
/// the kept frame, and wheel and shutter are asked whether they still stand.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Timing {
    /// Opening, identifying and closing the shutter, seconds.
    pub open_shutter_s: f64,
    /// Opening and identifying the wheel, seconds.
    pub open_wheel_s: f64,
    /// Opening and identifying one axis and finding its reference, seconds. How far the axis stands from its reference
    /// at the start is not known; this is for 37 degrees.
    pub open_axis_s: f64,
    /// Questions and answers around one axis move, seconds.
    pub move_command_s: f64,
    /// Distance of the polls that notice that an axis stands, seconds; 0 = at once.
    pub poll_s: f64,
    /// Starting and stopping the wheel and the question that proves the place, seconds; `step_s` a place on top.
    pub wheel_start_s: f64,
    /// Questions, toggle and blade's proof of closing the shutter, seconds; the instrument's settle time on top.
    pub shutter_close_s: f64,
    /// The same for opening, with the questions for interlock and mode before.
    pub shutter_open_s: f64,
    /// Questions to wheel and shutter after each kept frame, seconds.
    pub prove_s: f64,
    /// Questions to each axis after each kept frame, seconds.
    pub prove_axis_s: f64,
    /// Making the bench safe at the end: quiet lines, closing, stopping; the wheel's turn to its blank on top, seconds.
    pub safe_s: f64,
    /// Frames without any light that are looked at a second time, in each bracket with light: none where the shortest
    /// exposure still shows light, else one; which it is depends on the sample.
    pub second_looks: f64,
}

/// What the bench does in the forecast.
struct Bench<'a> {
    instrument: &'a Instrument,
    timing: Timing,
    tilt_deg: f64,
    spin_deg: f64,
    changer_deg: f64,
    slot: u8,
    open: bool,
    /// Free-running streams by camera.
    streams: BTreeMap<&'a str, Stream>,
    forecast: Forecast,
}

/// A camera's stream after its last kept frame.
#[derive(Debug, Clone, Copy)]
struct Stream {
    /// Start of that frame, seconds.
    start_s: f64,
    /// Distance of the frames that follow, seconds.
    period_s: f64,
    exposure: ExposureTime,
}

/// Time of a move over `distance_deg` with a trapezoidal (or, where short, triangular) speed profile, seconds.
pub fn move_s(axis: &Axis, distance_deg: f64) -> f64 {
    let (distance, speed, acceleration) = (distance_deg.abs(), axis.speed_deg_per_s, axis.acceleration_deg_per_s2);
    if distance * acceleration >= speed * speed {
        distance / speed + speed / acceleration
    } else {
        2.0 * (distance / acceleration).sqrt()
    }
}

/// Time of one axis from order to settled, seconds; 0 where it stands already.
pub fn axis_s(axis: &Axis, from_deg: f64, to_deg: f64, timing: &Timing) -> f64 {
    if (from_deg - to_deg).abs() < SAME_DEG {
        return 0.0;
    }
    let moving = move_s(axis, to_deg - from_deg);
    let noticed = if timing.poll_s > 0.0 { (moving / timing.poll_s).ceil() * timing.poll_s } else { moving };
    timing.move_command_s + noticed + axis.settle_s
}

/// Waiting for the lamp after the devices are open, seconds: the interlocks count from the start of the run, a lamp that
/// the light monitor watches from its first reading.
fn warm_up_s(instrument: &Instrument, opened_s: f64) -> f64 {
    let Some(interlocks) = &instrument.interlocks else { return 0.0 };
    let watched = instrument.light_monitor.as_ref().and(instrument.lamp.warm_up_s).unwrap_or(0.0);
    watched.max(interlocks.warm_up_s - opened_s)
}

/// Bytes of one pixel as it is stored.
pub fn bytes_per_pixel(format: PixelFormat) -> u64 {
    let word = if format.levels() > 256 { 2 } else { 1 };
    word * format.values_per_pixel() as u64
}

/// Plays views and steps through.
///
/// # Errors
/// A view or camera that the steps or views name is not there.
pub fn forecast(
    instrument: &Instrument,
    views: &[View],
    steps: &[Step],
    timing: &Timing,
) -> Result<Forecast, PlanError> {
    let mut bench = Bench::new(instrument, *timing);
    let mut current = None;
    for step in steps {
        let view = views.get(step.view as usize).ok_or(PlanError::NoSuchView { step: step.number, view: step.view })?;
        let (name, camera) = instrument
            .camera
            .get_key_value(&view.camera)
            .ok_or_else(|| PlanError::NoSuchCamera { view: view.id, camera: view.camera.clone() })?;
        if current != Some(step.view) {
            bench.pose(view);
            bench.second_look(camera, view);
            current = Some(step.view);
        }
        bench.expose(name, camera, step);
    }
    bench.end();
    Ok(bench.forecast)
}

// === impl Timing ===

impl Default for Timing {
    /// The drivers as they are, on a bench without faults: numbers of exchanges, counted in the drivers, times the time
    /// of an answer.
    ///
    /// - SC10, 8 ms an answer (9600 baud), every value asked twice: state 4, toggle 1 between two questions for enable
    ///   (2 + 1 + 2), blade 2; opening asks interlock and mode before (4). After a frame 4. Opening the device: 8 and
    ///   quiet times.
    /// - FW212C, 3 ms an answer: one place in 0.9 s, six in 2.9 s (the sheet, 4), so half a second beside 0.4 s a place;
    ///   1 for the turn, 2 for its proof; 2 after a frame.
    /// - Zaber, 3 ms an answer: seven questions around a move, polls of 50 ms and one answer; after a frame 3.
    fn default() -> Timing {
        Timing {
            open_shutter_s: 0.22,
            open_wheel_s: 0.136,
            open_axis_s: 2.502,
            move_command_s: 0.021,
            poll_s: 0.053,
            wheel_start_s: 0.509,
            shutter_close_s: 0.088,
            shutter_open_s: 0.12,
            prove_s: 0.038,
            prove_axis_s: 0.009,
            safe_s: 0.3,
            second_looks: 0.5,
        }
    }
}

// === impl Bench ===

impl<'a> Bench<'a> {
    /// The bench after opening and homing: axes at zero, wheel on place 1, shutter closed.
    fn new(instrument: &'a Instrument, timing: Timing) -> Bench<'a> {
        let axes = if instrument.holder.changer.is_some() { 3.0 } else { 2.0 };
        let shutter_s = timing.open_shutter_s + instrument.shutter.settle_s;
        let opened_s = shutter_s + timing.open_wheel_s + axes * timing.open_axis_s;
        let start_s = opened_s + warm_up_s(instrument, opened_s);
        let forecast = Forecast { start_s, ..Forecast::default() };
        Bench {
            instrument,
            timing,
            tilt_deg: 0.0,
            spin_deg: 0.0,
            changer_deg: 0.0,
            slot: 1,
            open: false,
            streams: BTreeMap::new(),
            forecast,
        }
    }

    /// Brings the bench to a view.
    fn pose(&mut self, view: &View) {
        let holder = &self.instrument.holder;
        let changer_deg = view.changer_deg.unwrap_or(self.changer_deg);
        let mut moving_s = axis_s(&holder.tilt, self.tilt_deg, view.tilt_deg, &self.timing)
            + axis_s(&holder.spin, self.spin_deg, view.spin_deg, &self.timing);
        if let Some(changer) = &holder.changer {
            moving_s += axis_s(&changer.axis, self.changer_deg, changer_deg, &self.timing);
        }
        let dark = view.subject == Subject::Dark;
        if self.open && (moving_s > 0.0 || view.slot.0 != self.slot || dark) {
            self.shutter(false);
        }
        self.forecast.moving_s += moving_s;
        self.forecast.filter_s += self.wheel_s(view.slot.0);
        if !dark && !self.open {
            self.shutter(true);
        }
        (self.tilt_deg, self.spin_deg, self.changer_deg) = (view.tilt_deg, view.spin_deg, changer_deg);
        self.slot = view.slot.0;
    }

    fn shutter(&mut self, open: bool) {
        let bringing_s = if open { self.timing.shutter_open_s } else { self.timing.shutter_close_s };
        self.forecast.shutter_s += bringing_s + self.instrument.shutter.settle_s;
        self.open = open;
    }

    /// The safe state after the last frame.
    fn end(&mut self) {
        let mut slots = self.instrument.filter_wheel.slot.iter();
        let blank = slots.find(|(_, slot)| slot.band == "dark").and_then(|(number, _)| number.parse().ok());
        let turn_s = blank.map_or(0.0, |blank| self.wheel_s(blank));
        // The driver proves the place; nobody waits for the wheel to settle.
        self.forecast.start_s += self.timing.safe_s + (turn_s - self.instrument.filter_wheel.settle_s).max(0.0);
    }

    fn wheel_s(&self, to: u8) -> f64 {
        let wheel = &self.instrument.filter_wheel;
        let around = self.slot.abs_diff(to);
        let places = around.min(wheel.places.saturating_sub(around));
        if around == 0 {
            return 0.0;
        }
        self.timing.wheel_start_s + f64::from(places) * wheel.step_s + wheel.settle_s
    }

    /// What the second looks of a bracket take in the mean: the black frames are the short ones, each followed by one
    /// more frame of the stream.
    fn second_look(&mut self, camera: &Camera, view: &View) {
        if view.subject != Subject::Dark {
            self.forecast.overhead_s += self.timing.second_looks * camera.readout_s.max(camera.frame_interval_s);
        }
    }

    /// One kept frame with all that goes before and after it.
    fn expose(&mut self, name: &'a str, camera: &Camera, step: &Step) {
        let exposure_s = step.exposure.seconds();
        let now_s = self.forecast.total_s();
        let restart_s = camera.restart_s.unwrap_or(f64::INFINITY);
        let waiting_s = match self.streams.get(name) {
            Some(stream) => stream.waiting_s(now_s, step.exposure, camera.discard_frames).min(restart_s),
            None => camera.restart_s.unwrap_or(0.0),
        };
        let period_s = (exposure_s + camera.readout_s).max(camera.frame_interval_s);
        self.streams.insert(name, Stream { start_s: now_s + waiting_s, period_s, exposure: step.exposure });
        self.forecast.exposing_s += exposure_s;
        let axes = if self.instrument.holder.changer.is_some() { 3.0 } else { 2.0 };
        let proving_s = self.timing.prove_s + axes * self.timing.prove_axis_s;
        self.forecast.overhead_s += waiting_s + camera.readout_s + proving_s;
        let pixels = camera.width_px as u64 * camera.height_px as u64;
        self.forecast.raw_bytes += pixels * bytes_per_pixel(camera.stored_format());
    }
}

// === impl Stream ===

impl Stream {
    /// From `now_s` to the start of the first frame that counts: the rest of the frame under way and, when the exposure
    /// changes, the frames that still have the settings before.
    fn waiting_s(&self, now_s: f64, exposure: ExposureTime, discard: u32) -> f64 {
        let since_s = now_s - self.start_s;
        let under_way_s = (since_s / self.period_s).ceil() * self.period_s - since_s;
        let discarded = if exposure == self.exposure { 0 } else { discard };
        under_way_s + f64::from(discarded) * self.period_s
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::config::testing::instrument;
    use goniod_drivers::units::{ExposureTime, Slot};

    fn view(id: u32, subject: Subject, slot: u8, tilt_deg: f64) -> View {
        View {
            id,
            array_index: id,
            camera: "ccd".into(),
            subject,
            repeat: 0,
            band: None,
            slot: Slot(slot),
            tilt_deg,
            spin_deg: 0.0,
            changer_deg: Some(0.0),
        }
    }

    #[test]
    fn a_move_is_a_trapezoid() {
        let axis = &instrument().holder.tilt;
        // 20 deg/s and 40 deg/s^2: the ramps take 0.5 s and 5 degrees each.
        assert!((move_s(axis, 90.0) - 5.0).abs() < 1e-12);
        assert!((move_s(axis, -10.0) - 1.0).abs() < 1e-12);
        assert!((move_s(axis, 2.5) - 0.5).abs() < 1e-12);
        let timing = Timing { move_command_s: 0.01, poll_s: 0.06, ..Timing::default() };
        assert!(
            (axis_s(axis, 0.0, 0.1, &timing) - (0.01 + 0.12 + 0.2)).abs() < 1e-9,
            "100 ms, seen at the second poll"
        );
        assert_eq!(axis_s(axis, 3.0, 3.0, &timing), 0.0);
    }

    /// One reference view and one dark, added up by hand.
    #[test]
    fn the_forecast_is_the_sum_of_its_parts() {
        let mut i = instrument();
        let views = [view(0, Subject::Reference { transmission: false }, 3, 90.0), view(1, Subject::Dark, 12, 90.0)];
        let step = |number, view, us| Step { number, view, exposure_index: 0, exposure: ExposureTime(us) };
        let steps = [step(0, 0, 1_000_000), step(1, 0, 1_000), step(2, 1, 1_000)];
        let timing = Timing::default();
        let f = forecast(&i, &views, &steps, &timing).unwrap();
        // 90 degrees in 5 s, seen at the 95th poll.
        assert!((f.moving_s - (0.021 + 95.0 * 0.053 + 0.2)).abs() < 1e-9, "{f:?}");
        // Place 1 to 3: two places; 3 to 12: three the shorter way.
        assert!((f.filter_s - (5.0 * 0.4 + 2.0 * (0.509 + 0.1))).abs() < 1e-9, "{f:?}");
        assert!((f.shutter_s - (0.12 + 0.088 + 2.0 * 0.05)).abs() < 1e-9, "opened once, closed once: {f:?}");
        assert!((f.exposing_s - 1.002).abs() < 1e-9);
        // Two restarts of 0.1 s; the dark keeps its exposure and waits for a frame under way, at most an interval;
        // read-outs, questions to the bench and to three axes, and half a second look.
        let asked_s = 0.038 + 3.0 * 0.009;
        let waited = f.overhead_s - 2.0 * 0.1 - 3.0 * (0.06 + asked_s) - 0.5 * 0.0667;
        assert!((0.0..0.0667).contains(&waited), "{f:?}");
        assert_eq!(f.raw_bytes, 3 * 1392 * 1040);
        // The wheel is on its blank already at the end.
        assert!((f.start_s - (0.22 + 0.05 + 0.136 + 3.0 * 2.502 + 0.3)).abs() < 1e-9);
        // A lamp that is watched is waited for from its first reading on, the interlocks' warm-up from the start.
        let mut warm = i.clone();
        warm.interlocks = Some(crate::config::night::Interlocks { warm_up_s: 60.0, ..Default::default() });
        assert!((forecast(&warm, &views, &steps, &timing).unwrap().start_s - (60.0 + 0.3)).abs() < 1e-9);
        warm.lamp.warm_up_s = Some(300.0);
        assert!((forecast(&warm, &views, &steps, &timing).unwrap().start_s - (60.0 + 0.3)).abs() < 1e-9, "no monitor");
        warm.light_monitor = Some(crate::config::testing::light_monitor());
        assert!((forecast(&warm, &views, &steps, &timing).unwrap().start_s - (f.start_s + 300.0)).abs() < 1e-9);
        warm.interlocks = None;
        assert_eq!(
            forecast(&warm, &views, &steps, &timing).unwrap().start_s,
            f.start_s,
            "nobody watches, nobody waits"
        );
        // Without restart the first frame comes at once. After it, 65 ms of the next frame of 1.06 s are over, and two
        // more go by; the dark waits as before or differs by its phase.
        i.camera.get_mut("ccd").unwrap().restart_s = None;
        let slow = forecast(&i, &views, &steps, &timing).unwrap();
        let waited = slow.overhead_s - (3.0 * 1.06 - asked_s) - 3.0 * (0.06 + asked_s) - 0.5 * 0.0667;
        assert!((0.0..0.0667).contains(&waited), "{slow:?}");
        assert!(forecast(&i, &views, &[step(0, 9, 1)], &timing).is_err());
    }
}
