//! A device of any kind in one vocabulary: what may be ordered, what must be refused, what it says of itself.

use crate::contract::{
    Camera, CameraSettings, Device, FilterWheel, LightMonitor, LightReading, Monochromator, RotaryAxis, Shutter,
    ShutterState, Spectrometer, Spectrum,
};
use crate::error::{DeviceError, ErrorKind, Result};
use crate::units::{Degrees, ExposureTime, Nanometres, Slot};
use std::fmt;

/// Largest difference between an order and what was reached for them to be the same, where the contract gives no
/// tolerance: degrees, nanometres, and the rounding of integration times (relative, and in microseconds).
const SAME_DEG: f64 = 0.1;
const SAME_NM: f64 = 1.0;
const SAME_TIME: (f64, u64) = (0.01, 1000);
/// Frames that are taken at most for one that counts.
const MOST_FRAMES: u32 = 16;

/// A device of its kind.
pub enum Subject {
    /// A rotation axis.
    Axis(Box<dyn RotaryAxis>),
    /// A filter wheel.
    Wheel(Box<dyn FilterWheel>),
    /// A shutter.
    Shutter(Box<dyn Shutter>),
    /// A light monitor.
    LightMonitor(Box<dyn LightMonitor>),
    /// A monochromator.
    Monochromator(Box<dyn Monochromator>),
    /// A spectrometer.
    Spectrometer(Box<dyn Spectrometer>),
    /// A camera.
    Camera(Box<dyn Camera>),
}

/// What a device is told, or says of itself.
#[derive(Debug, Clone, PartialEq)]
pub enum Value {
    /// Angle of an axis.
    Angle(Degrees),
    /// Place of a wheel.
    Place(Slot),
    /// State of a shutter.
    Blade(ShutterState),
    /// Wavelength of a monochromator or of a monitor's correction.
    Wavelength(Nanometres),
    /// Integration time of a spectrometer.
    Exposure(ExposureTime),
    /// Settings of a camera, or those that a frame carries.
    Settings(CameraSettings),
    /// A reading of a light monitor.
    Light(LightReading),
    /// A spectrum.
    Spectrum(Spectrum),
}

// === impl Value ===

impl Value {
    /// True when `said` is what an order asked for.
    pub fn met_by(&self, said: &Value) -> bool {
        let time = |a: ExposureTime, b: ExposureTime| {
            let off = a.0.abs_diff(b.0);
            off <= SAME_TIME.1 || off as f64 <= SAME_TIME.0 * a.0 as f64
        };
        match (self, said) {
            (Value::Angle(a), Value::Angle(b)) => a.distance(*b).0 <= SAME_DEG,
            (Value::Wavelength(a), Value::Wavelength(b)) => (a.0 - b.0).abs() <= SAME_NM,
            (Value::Wavelength(a), Value::Light(b)) => (a.0 - b.wavelength.0).abs() <= SAME_NM,
            (Value::Exposure(a), Value::Exposure(b)) => time(*a, *b),
            (Value::Exposure(a), Value::Spectrum(b)) => time(*a, b.exposure),
            (Value::Settings(a), Value::Settings(b)) => time(a.exposure, b.exposure),
            (a, b) => a == b,
        }
    }
}

impl fmt::Display for Value {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Value::Angle(v) => v.fmt(f),
            Value::Place(v) => v.fmt(f),
            Value::Blade(ShutterState::Open) => f.write_str("open"),
            Value::Blade(ShutterState::Closed) => f.write_str("closed"),
            Value::Wavelength(v) => v.fmt(f),
            Value::Exposure(v) => v.fmt(f),
            Value::Settings(v) => write!(f, "{} at gain {}", v.exposure, v.gain),
            Value::Light(v) => write!(f, "{:e} W at {}", v.power_w, v.wavelength),
            Value::Spectrum(v) => write!(f, "a spectrum of {} pixels over {}", v.counts.len(), v.exposure),
        }
    }
}

// === impl Subject ===

impl Subject {
    /// What every device can do.
    pub fn device(&mut self) -> &mut dyn Device {
        match self {
            Subject::Axis(device) => device.as_mut(),
            Subject::Wheel(device) => device.as_mut(),
            Subject::Shutter(device) => device.as_mut(),
            Subject::LightMonitor(device) => device.as_mut(),
            Subject::Monochromator(device) => device.as_mut(),
            Subject::Spectrometer(device) => device.as_mut(),
            Subject::Camera(device) => device.as_mut(),
        }
    }

    /// True for a device that moves something: an operator is asked before.
    pub fn moves(&self) -> bool {
        matches!(self, Subject::Axis(_) | Subject::Wheel(_) | Subject::Shutter(_) | Subject::Monochromator(_))
    }

    /// Finds the reference where the kind has one; nothing for the others.
    pub async fn reference(&mut self) -> Result<()> {
        match self {
            Subject::Axis(axis) => axis.home().await,
            _ => Ok(()),
        }
    }

    /// Carries an order out and gives what the driver says was reached or applied. An order of another kind is `Refused`.
    pub async fn carry_out(&mut self, order: &Value) -> Result<Value> {
        match (self, order) {
            (Subject::Axis(axis), Value::Angle(to)) => axis.move_to(*to).await.map(Value::Angle),
            (Subject::Wheel(wheel), Value::Place(to)) => wheel.select(*to).await.map(Value::Place),
            (Subject::Shutter(shutter), Value::Blade(to)) => shutter.set(*to).await.map(|()| order.clone()),
            (Subject::Monochromator(m), Value::Wavelength(to)) => m.tune(*to).await.map(Value::Wavelength),
            (Subject::LightMonitor(m), Value::Wavelength(to)) => m.apply(*to).await.map(Value::Wavelength),
            (Subject::Spectrometer(s), Value::Exposure(to)) => s.apply(*to).await.map(Value::Exposure),
            (Subject::Camera(camera), Value::Settings(to)) => camera.apply(*to).await.map(Value::Settings),
            _ => Err(DeviceError::new(ErrorKind::Refused, "conformance", format!("{order} is no order for this kind"))),
        }
    }

    /// What the device says of itself: position, place, state, wavelength, a reading, a spectrum, or the settings that a
    /// frame carries. `None` while it is unknown.
    pub async fn state(&mut self) -> Result<Option<Value>> {
        match self {
            Subject::Axis(axis) => Ok(axis.position().await?.map(Value::Angle)),
            Subject::Wheel(wheel) => Ok(wheel.slot().await?.map(Value::Place)),
            Subject::Shutter(shutter) => Ok(shutter.state().await?.map(Value::Blade)),
            Subject::Monochromator(m) => Ok(m.wavelength().await?.map(Value::Wavelength)),
            Subject::LightMonitor(m) => m.read().await.map(|reading| Some(Value::Light(reading))),
            Subject::Spectrometer(s) => s.acquire().await.map(|spectrum| Some(Value::Spectrum(spectrum))),
            Subject::Camera(camera) => frame(camera.as_mut()).await,
        }
    }

    /// Orders that the limits permit, few, harmless and near each other; two in a row always differ.
    pub fn orders(&self) -> Vec<Value> {
        match self {
            Subject::Axis(axis) => {
                let (low, high) = axis.limits();
                let base = 0.0_f64.clamp(low.0, high.0);
                let room = (high.0 - base).min(6.0);
                [0.5, 1.0, 0.2, 0.75].map(|part| Value::Angle(Degrees(base + part * room))).into()
            }
            Subject::Wheel(wheel) => {
                let n = wheel.slots().max(1);
                [n / 2 + 1, 1, 2.min(n), n].map(|place| Value::Place(Slot(place))).into()
            }
            Subject::Shutter(_) => [ShutterState::Open, ShutterState::Closed].map(Value::Blade).into(),
            Subject::Monochromator(m) => {
                let (low, high) = m.limits();
                let at = |part: f64| Value::Wavelength(Nanometres((low.0 + part * (high.0 - low.0)).round()));
                [0.3, 0.4, 0.35, 0.33].map(at).into()
            }
            Subject::LightMonitor(_) => [600.0, 500.0, 550.0].map(|nm| Value::Wavelength(Nanometres(nm))).into(),
            Subject::Spectrometer(s) => {
                let (shortest, longest) = s.limits();
                let at = |us: u64| Value::Exposure(ExposureTime(us).clamp(shortest, longest));
                [50_000, 20_000, 100_000].map(at).into()
            }
            Subject::Camera(camera) => {
                let info = camera.info();
                let exposure = |us: u64| ExposureTime(us).clamp(info.shortest, info.longest.max(info.shortest));
                let at = |us: u64| Value::Settings(CameraSettings { exposure: exposure(us), gain: 0.0 });
                [20_000, 5000, 40_000].map(at).into()
            }
        }
    }

    /// Orders that must be refused before a byte is sent, with the words of what they are.
    pub fn forbidden(&self) -> Vec<Value> {
        let around = |low: f64, high: f64, step: f64| [low - step, high + step, f64::NAN, f64::INFINITY];
        match self {
            Subject::Axis(axis) => {
                let (low, high) = axis.limits();
                around(low.0, high.0, 0.1).map(|v| Value::Angle(Degrees(v))).into()
            }
            Subject::Wheel(wheel) => {
                let last = wheel.slots();
                let outside = [0, last.saturating_add(1), u8::MAX].into_iter().filter(|n| *n == 0 || *n > last);
                outside.map(|place| Value::Place(Slot(place))).collect()
            }
            Subject::Shutter(_) => Vec::new(),
            Subject::Monochromator(m) => {
                let (low, high) = m.limits();
                around(low.0, high.0, 0.1).map(|v| Value::Wavelength(Nanometres(v))).into()
            }
            Subject::LightMonitor(_) => {
                [-1.0, 1e9, f64::NAN, f64::INFINITY].map(|v| Value::Wavelength(Nanometres(v))).into()
            }
            Subject::Spectrometer(s) => {
                let (shortest, longest) = s.limits();
                outside(shortest, longest).into_iter().map(Value::Exposure).collect()
            }
            Subject::Camera(camera) => {
                let times = outside(camera.info().shortest, camera.info().longest);
                times.into_iter().map(|exposure| Value::Settings(CameraSettings { exposure, gain: 0.0 })).collect()
            }
        }
    }
}

/// Integration times just outside the limits.
fn outside(shortest: ExposureTime, longest: ExposureTime) -> Vec<ExposureTime> {
    let below = shortest.0.checked_sub(1).map(ExposureTime);
    below.into_iter().chain(longest.0.checked_add(1).map(ExposureTime)).collect()
}

/// The settings of the first frame that counts after an arm; `None` where none counted.
async fn frame(camera: &mut dyn Camera) -> Result<Option<Value>> {
    let armed = camera.arm().await?;
    let mut discard = armed.discard;
    for _ in 0..MOST_FRAMES {
        let frame = camera.next_frame().await?;
        if frame.info.damaged || frame.info.exposure_start < armed.not_before {
            continue;
        }
        if discard > 0 {
            discard -= 1;
            continue;
        }
        camera.stop().await?;
        return Ok(Some(Value::Settings(frame.info.settings)));
    }
    camera.stop().await?;
    Ok(None)
}
