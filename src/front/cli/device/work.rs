//! What a hand does to an open device: look, move, read; limits are compared before anything is sent.

use super::say::Report;
use crate::config::instrument::{Axis, Instrument};
use goniod_drivers::clock::Clock;
use goniod_drivers::conformance::Subject;
use goniod_drivers::contract::{Camera, CameraSettings, Identity, RotaryAxis, ShutterState, Spectrometer};
use goniod_drivers::error::{DeviceError, ErrorKind, Result};
use goniod_drivers::units::{Degrees, ExposureTime, Nanometres, Slot};
use std::future::Future;
use std::time::Duration;

/// Limit for anything that is not a move, beyond the drivers' own.
const LIMIT: Duration = Duration::from_secs(120);
/// Limit for finding a reference or moving, beyond the drivers' own.
const MOVE_LIMIT: Duration = Duration::from_secs(600);
/// Integration time where none is asked for.
const USUAL_EXPOSURE_S: f64 = 0.01;

/// Where to.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Target {
    /// The axis' reference.
    Home,
    /// An angle of the axis.
    Angle(Degrees),
    /// A place of the wheel.
    Place(Slot),
    /// A state of the shutter.
    Shutter(ShutterState),
    /// A wavelength.
    Wavelength(Nanometres),
}

// === impl Target ===

impl Target {
    /// The target of device `name` as written on the command line, when the instrument file permits it.
    ///
    /// # Errors
    /// A sentence for the operator.
    pub fn of(instrument: &Instrument, name: &str, to: &str) -> std::result::Result<Target, String> {
        let holder = &instrument.holder;
        let changer = holder.changer.as_ref().map(|c| &c.axis);
        match (name, changer) {
            ("tilt", _) => angle(name, &holder.tilt, to),
            ("spin", _) => angle(name, &holder.spin, to),
            ("changer", Some(axis)) => angle(name, axis, to),
            ("filter_wheel", _) => place(instrument, to),
            ("shutter", _) => match to {
                "open" => Ok(Target::Shutter(ShutterState::Open)),
                "closed" | "close" => Ok(Target::Shutter(ShutterState::Closed)),
                _ => Err(format!("the shutter cannot be `{to}`; write `open` or `closed`")),
            },
            ("monochromator", _) => wavelength(instrument, to),
            _ => Err(format!("`{name}` does not move; look at it with `goniod device show {name}`")),
        }
    }
}

fn angle(name: &str, axis: &Axis, to: &str) -> std::result::Result<Target, String> {
    if to == "home" {
        return Ok(Target::Home);
    }
    let (min, max) = (axis.min_deg, axis.max_deg);
    match to.parse::<f64>() {
        Ok(degrees) if degrees >= min && degrees <= max => Ok(Target::Angle(Degrees(degrees))),
        Ok(degrees) => {
            Err(format!("{name} may go from {min} to {max} degrees, not to {degrees}; see min_deg and max_deg"))
        }
        Err(_) => Err(format!("{name} cannot go to `{to}`; write an angle from {min} to {max} degrees, or `home`")),
    }
}

fn place(instrument: &Instrument, to: &str) -> std::result::Result<Target, String> {
    let wheel = &instrument.filter_wheel;
    let by_band = wheel.slot.iter().find(|(_, slot)| slot.band == to).map(|(number, _)| number.as_str());
    match by_band.unwrap_or(to).parse::<u8>() {
        Ok(place) if place >= 1 && place <= wheel.places => Ok(Target::Place(Slot(place))),
        _ => {
            let bands = wheel.slot.values().map(|slot| slot.band.as_str()).collect::<Vec<_>>().join(", ");
            Err(format!("the filter wheel has no place `{to}`; write 1 to {} or a band: {bands}", wheel.places))
        }
    }
}

fn wavelength(instrument: &Instrument, to: &str) -> std::result::Result<Target, String> {
    let (min, max) = instrument.monochromator.as_ref().map_or((0.0, 0.0), |m| (m.min_nm, m.max_nm));
    match to.parse::<f64>() {
        Ok(nm) if nm >= min && nm <= max => Ok(Target::Wavelength(Nanometres(nm))),
        _ => Err(format!("the monochromator cannot go to `{to}`; write a wavelength from {min} to {max} nanometres")),
    }
}

/// An integration time asked for, when the instrument file permits it.
///
/// # Errors
/// A sentence for the operator.
pub fn exposure(instrument: &Instrument, name: &str, seconds: f64) -> std::result::Result<ExposureTime, String> {
    let (low, high) = instrument.camera.get(name).map_or((1e-6, 60.0), |c| (c.shortest_s, c.longest_s));
    if seconds >= low && seconds <= high {
        return Ok(ExposureTime::from_seconds(seconds));
    }
    Err(format!("an exposure of {seconds} s of {name} is not possible; {low} to {high} s is allowed"))
}

/// Opens the device and proves who it is.
///
/// # Errors
/// The device's own.
pub async fn identify(hand: &mut Subject, clock: Clock) -> Result<Identity> {
    limited(clock, LIMIT, hand.device().open()).await
}

/// Health and state.
///
/// # Errors
/// The device's own.
pub async fn look(hand: &mut Subject, report: &mut Report, clock: Clock) -> Result<()> {
    report.health = Some(limited(clock, LIMIT, hand.device().health()).await?);
    state(hand, report, clock).await
}

/// Where the device stands now.
async fn state(hand: &mut Subject, report: &mut Report, clock: Clock) -> Result<()> {
    let text = |value: Option<String>| Some(value.unwrap_or_else(|| "unknown".to_owned()));
    report.state = match hand {
        Subject::Axis(axis) => text(limited(clock, LIMIT, axis.position()).await?.map(|at| at.to_string())),
        Subject::Wheel(wheel) => text(limited(clock, LIMIT, wheel.slot()).await?.map(|slot| slot.to_string())),
        Subject::Shutter(shutter) => {
            let state = limited(clock, LIMIT, shutter.state()).await?;
            text(state.map(|s| format!("{s:?}").to_lowercase()))
        }
        Subject::Monochromator(m) => text(limited(clock, LIMIT, m.wavelength()).await?.map(|at| at.to_string())),
        Subject::Camera(camera) => {
            let info = camera.info();
            Some(format!(
                "{} x {} pixels, {:?}, {} to {}",
                info.width, info.height, info.format, info.shortest, info.longest
            ))
        }
        Subject::LightMonitor(_) | Subject::Spectrometer(_) => None,
    };
    Ok(())
}

/// Moves and proves; an axis without reference finds it first, as in a run.
///
/// # Errors
/// The device's own.
pub async fn go(hand: &mut Subject, target: Target, report: &mut Report, clock: Clock) -> Result<()> {
    match (&mut *hand, target) {
        (Subject::Axis(axis), Target::Home) => limited(clock, MOVE_LIMIT, axis.home()).await?,
        (Subject::Axis(axis), Target::Angle(angle)) => turn(axis.as_mut(), angle, report, clock).await?,
        (Subject::Wheel(wheel), Target::Place(slot)) => drop(limited(clock, MOVE_LIMIT, wheel.select(slot)).await?),
        (Subject::Shutter(shutter), Target::Shutter(state)) => limited(clock, MOVE_LIMIT, shutter.set(state)).await?,
        (Subject::Monochromator(m), Target::Wavelength(nm)) => drop(limited(clock, MOVE_LIMIT, m.tune(nm)).await?),
        _ => return Err(DeviceError::new(ErrorKind::Refused, &report.name, "it cannot be moved so")),
    }
    state(hand, report, clock).await
}

async fn turn(axis: &mut dyn RotaryAxis, angle: Degrees, report: &mut Report, clock: Clock) -> Result<()> {
    if limited(clock, LIMIT, axis.position()).await?.is_none() {
        report.notes.push("it had no reference and found it first".to_owned());
        limited(clock, MOVE_LIMIT, axis.home()).await?;
    }
    limited(clock, MOVE_LIMIT, axis.move_to(angle)).await.map(drop)
}

/// One reading; of a device that only stands somewhere, its state. `settings` are exposure and camera gain.
///
/// # Errors
/// The device's own.
pub async fn read(
    hand: &mut Subject,
    settings: (Option<ExposureTime>, f64),
    report: &mut Report,
    clock: Clock,
) -> Result<()> {
    let (exposure, gain) = settings;
    match hand {
        Subject::LightMonitor(monitor) => {
            let reading = limited(clock, LIMIT, monitor.read()).await?;
            report.reading("power_w", reading.power_w);
            report.reading("wavelength_nm", reading.wavelength.0);
            if reading.saturated {
                report.notes.push("saturated: the power is no measurement".to_owned());
            }
        }
        Subject::Spectrometer(spectrometer) => spectrum(spectrometer.as_mut(), exposure, report, clock).await?,
        Subject::Camera(camera) => frame(camera.as_mut(), exposure, gain, report, clock).await?,
        _ => state(hand, report, clock).await?,
    }
    Ok(())
}

async fn spectrum(
    spectrometer: &mut dyn Spectrometer,
    exposure: Option<ExposureTime>,
    report: &mut Report,
    clock: Clock,
) -> Result<()> {
    let (low, high) = spectrometer.limits();
    let wanted = exposure.unwrap_or(ExposureTime::from_seconds(USUAL_EXPOSURE_S)).clamp(low, high);
    let applied = limited(clock, LIMIT, spectrometer.apply(wanted)).await?;
    let spectrum = limited(clock, LIMIT + 3 * applied.duration(), spectrometer.acquire()).await?;
    let peak = spectrum.counts.iter().zip(&spectrum.wavelength_nm).max_by(|a, b| a.0.total_cmp(b.0));
    report.reading("exposure_s", spectrum.exposure.seconds());
    report.reading("pixels", spectrum.counts.len() as f64);
    report.reading("saturated_pixels", spectrum.saturated as f64);
    if let Some((counts, nm)) = peak {
        report.reading("peak_counts", *counts);
        report.reading("peak_nm", *nm);
    }
    Ok(())
}

async fn frame(
    camera: &mut dyn Camera,
    exposure: Option<ExposureTime>,
    gain: f64,
    report: &mut Report,
    clock: Clock,
) -> Result<()> {
    let (low, high, levels) = (camera.info().shortest, camera.info().longest, camera.info().format.levels());
    let wanted = exposure.unwrap_or(ExposureTime::from_seconds(USUAL_EXPOSURE_S)).clamp(low, high);
    let settings = limited(clock, LIMIT, camera.apply(CameraSettings { exposure: wanted, gain })).await?;
    let armed = limited(clock, LIMIT, camera.arm()).await?;
    let mut discard = armed.discard;
    let frame = loop {
        let frame = limited(clock, LIMIT + armed.due_within, camera.next_frame()).await?;
        if frame.info.exposure_start < armed.not_before {
            continue;
        }
        if discard == 0 {
            break frame;
        }
        discard -= 1;
    };
    limited(clock, LIMIT, camera.stop()).await?;
    let values = (0..frame.pixels.len()).map(|i| f64::from(frame.pixels.level(i)));
    let (count, sum, max, min) =
        values.fold((0_u32, 0.0, 0.0_f64, f64::INFINITY), |(n, s, hi, lo), v| (n + 1, s + v, hi.max(v), lo.min(v)));
    report.reading("exposure_s", settings.exposure.seconds());
    report.reading("frame_id", frame.info.device_frame_id as f64);
    report.reading("min_level", min);
    report.reading("mean_level", sum / f64::from(count.max(1)));
    report.reading("max_level", max);
    report.reading("levels", f64::from(levels));
    if frame.info.damaged {
        report.notes.push("the frame is damaged".to_owned());
    }
    Ok(())
}

/// The device's answer, or a time-out of ours when it does not keep its own.
async fn limited<T>(clock: Clock, limit: Duration, work: impl Future<Output = Result<T>>) -> Result<T> {
    clock.timeout(limit, work).await.unwrap_or_else(|_| {
        let what = format!("no end within {} s; check its cable and power", limit.as_secs());
        Err(DeviceError::new(ErrorKind::Timeout, "the device", what))
    })
}
