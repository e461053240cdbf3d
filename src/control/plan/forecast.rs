//! How long a plan takes and how much it writes: the sequencer's moves played through with the instrument's numbers.

use super::build::PlanError;
use super::{Forecast, Step, View};
use crate::config::instrument::{Axis, Camera, Instrument};
use crate::control::plan::Subject;
use goniod_drivers::frame::PixelFormat;

/// Two commanded angles nearer than this are one pose, degrees; axes are commanded in millionths.
const SAME_DEG: f64 = 1e-7;

/// What the forecast supposes about the sequencer and the drivers, besides the numbers of the instrument file.
///
/// The model: the shutter is closed before anything turns and opened again before the next exposure with light; tilt,
/// spin and changer move one after the other, then the wheel turns the shorter way round; each motion is noticed at the
/// next poll; after every change of integration time, filter or pose `discard_frames` frames of the free-running
/// camera go by, each as long as the larger of integration + read-out and the frame interval, then comes the kept one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Timing {
    /// Opening and identifying one device, seconds.
    pub open_s: f64,
    /// Finding the reference of one axis, seconds.
    pub home_s: f64,
    /// Commands around one axis move (order, answer, read-back), seconds.
    pub move_command_s: f64,
    /// Distance of the polls that notice that an axis stands, seconds; 0 = at once.
    pub poll_s: f64,
    /// Commands around one turn of the wheel, seconds.
    pub wheel_command_s: f64,
    /// Commands and blade travel of one change of the shutter, seconds; the instrument's settle time comes on top.
    pub shutter_command_s: f64,
    /// Writing and reading back a camera's settings and arming it, seconds for each kept frame.
    pub arm_s: f64,
    /// Part of a frame that is under way when the camera is armed and must end first, 0 to 1: of the setting before.
    pub frame_under_way: f64,
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
    forecast: Forecast,
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
    let mut before_s = 0.0;
    for step in steps {
        let view = views.get(step.view as usize).ok_or(PlanError::NoSuchView { step: step.number, view: step.view })?;
        let camera = instrument
            .camera
            .get(&view.camera)
            .ok_or_else(|| PlanError::NoSuchCamera { view: view.id, camera: view.camera.clone() })?;
        if current != Some(step.view) {
            bench.pose(view);
            current = Some(step.view);
        }
        before_s = bench.expose(camera, step, before_s);
    }
    Ok(bench.forecast)
}

// === impl Timing ===

impl Default for Timing {
    /// What the drivers and the sequencer do on a bench without faults; poll distance from the Zaber sheet, 7.
    fn default() -> Timing {
        Timing {
            open_s: 0.2,
            home_s: 5.0,
            move_command_s: 0.0,
            poll_s: 0.05,
            wheel_command_s: 0.0,
            shutter_command_s: 0.0,
            arm_s: 0.0,
            frame_under_way: 0.0,
        }
    }
}

// === impl Bench ===

impl<'a> Bench<'a> {
    /// The bench after opening and homing: axes at zero, wheel on place 1, shutter closed.
    fn new(instrument: &'a Instrument, timing: Timing) -> Bench<'a> {
        let axes = if instrument.holder.changer.is_some() { 3.0 } else { 2.0 };
        let devices = axes + 2.0 + instrument.camera.len() as f64;
        let start_s = devices * timing.open_s + axes * timing.home_s;
        let forecast = Forecast { start_s, ..Forecast::default() };
        Bench { instrument, timing, tilt_deg: 0.0, spin_deg: 0.0, changer_deg: 0.0, slot: 1, open: false, forecast }
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
        self.forecast.shutter_s += self.timing.shutter_command_s + self.instrument.shutter.settle_s;
        self.open = open;
    }

    fn wheel_s(&self, to: u8) -> f64 {
        let wheel = &self.instrument.filter_wheel;
        let around = self.slot.abs_diff(to);
        let places = around.min(wheel.places.saturating_sub(around));
        if around == 0 {
            return 0.0;
        }
        self.timing.wheel_command_s + f64::from(places) * wheel.step_s + wheel.settle_s
    }

    /// One kept frame with all that goes before it; gives the length of its frames, seconds.
    fn expose(&mut self, camera: &Camera, step: &Step, before_s: f64) -> f64 {
        let exposure_s = step.exposure.seconds();
        let frame_s = (exposure_s + camera.readout_s).max(camera.frame_interval_s);
        let thrown_s = f64::from(camera.discard_frames) * frame_s + self.timing.frame_under_way * before_s;
        self.forecast.exposing_s += exposure_s;
        self.forecast.overhead_s += self.timing.arm_s + thrown_s + frame_s - exposure_s;
        let pixels = camera.width_px as u64 * camera.height_px as u64;
        self.forecast.raw_bytes += pixels * bytes_per_pixel(camera.format);
        frame_s
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
        let timing = Timing::default();
        assert!((axis_s(axis, 0.0, 0.1, &timing) - (0.1 + 0.2)).abs() < 1e-9, "100 ms, noticed at the second poll");
        assert_eq!(axis_s(axis, 3.0, 3.0, &timing), 0.0);
    }

    /// One reference view and one dark, added up by hand.
    #[test]
    fn the_forecast_is_the_sum_of_its_parts() {
        let i = instrument();
        let views = [view(0, Subject::Reference { transmission: false }, 3, 90.0), view(1, Subject::Dark, 12, 90.0)];
        let step = |number, view, us| Step { number, view, exposure_index: 0, exposure: ExposureTime(us) };
        let steps = [step(0, 0, 1_000_000), step(1, 0, 1_000), step(2, 1, 1_000)];
        let f = forecast(&i, &views, &steps, &Timing::default()).unwrap();
        assert!((f.moving_s - 5.2).abs() < 1e-9, "{f:?}");
        // Place 1 to 3: two places; 3 to 12: three the shorter way.
        assert!((f.filter_s - (5.0 * 0.5 + 2.0 * 0.1)).abs() < 1e-9, "{f:?}");
        assert!((f.shutter_s - 2.0 * 0.05).abs() < 1e-9, "opened once, closed once: {f:?}");
        assert!((f.exposing_s - 1.002).abs() < 1e-9);
        // Two frames thrown away and the kept one's read-out: 2 x 1.04 + 0.04, then twice 2 x 0.041 + 0.04.
        assert!((f.overhead_s - (2.12 + 2.0 * 0.122)).abs() < 1e-9, "{f:?}");
        assert_eq!(f.raw_bytes, 3 * 1392 * 1040);
        assert!((f.start_s - (7.0 * 0.2 + 15.0)).abs() < 1e-9);
        let bad = [step(0, 9, 1)];
        assert!(forecast(&i, &views, &bad, &Timing::default()).is_err());
    }
}
