//! Settings on the device: automatic functions off first, then the values, then everything read back.

use super::config::{AUTOMATIC_OFF, ScaledControl, V4l2Config};
use super::fault::Fault;
use super::sys;
use crate::error::{ErrorKind, Result};
use std::io;
use v4l::Device;
use v4l::fraction::Fraction;
use v4l::video::Capture;
use v4l::video::capture::Parameters;

/// Raw values of the two settings that change during a night.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RawSettings {
    /// Raw exposure.
    pub exposure: i32,
    /// Raw gain; `None` for a camera without.
    pub gain: Option<i32>,
}

/// Switches every automatic function off and writes the fixed controls; each is proven by reading it back.
///
/// # Errors
/// `Broken` when one stays on or reads back differently.
pub fn prepare(device: &Device, config: &V4l2Config) -> Result<()> {
    let fault = Fault(&config.name);
    for (id, off, what) in AUTOMATIC_OFF {
        match sys::get_control(device, id) {
            Err(e) if e.raw_os_error() == Some(libc::EINVAL) => continue,
            Err(e) => return Err(fault.io(&format!("reading {what}"), &e)),
            Ok(value) if value == off => continue,
            Ok(_) => {}
        }
        prove(device, id, off, &fault, what)?;
    }
    for (id, value) in &config.fixed {
        prove(device, *id, *value, &fault, &format!("control {id:#010x}"))?;
    }
    Ok(())
}

fn prove(device: &Device, id: u32, value: i32, fault: &Fault, what: &str) -> Result<()> {
    sys::set_control(device, id, value).map_err(|e| fault.io(&format!("setting {what} to {value}"), &e))?;
    let now = sys::get_control(device, id).map_err(|e| fault.io(&format!("reading {what}"), &e))?;
    if now == value {
        return Ok(());
    }
    Err(fault.of(
        ErrorKind::Broken,
        format!("{what} was set to {value} and reads {now}; another program or the bridge changes it, stop that first"),
    ))
}

/// The raw value for a physical one, inside the control's range.
///
/// # Errors
/// `Refused` when the device has no such control or the value is outside its range.
pub fn raw_in_range(device: &Device, config: &V4l2Config, c: ScaledControl, value: f64, what: &str) -> Result<i32> {
    let fault = Fault(&config.name);
    let range = sys::query_control(device, c.id)
        .map_err(|e| fault.io(&format!("asking for the range of {what} (control {:#010x})", c.id), &e))?;
    let raw = c.raw(value);
    if range.fixed || raw < range.minimum || raw > range.maximum {
        let (low, high) = (range.minimum as f64 * c.scale + c.offset, range.maximum as f64 * c.scale + c.offset);
        return Err(fault.of(ErrorKind::Refused, format!("{what} {value} is outside the camera's {low} to {high}")));
    }
    Ok(raw as i32)
}

/// Writes exposure and gain.
pub fn write(device: &Device, config: &V4l2Config, raw: RawSettings) -> Result<()> {
    let fault = Fault(&config.name);
    sys::set_control(device, config.exposure.id, raw.exposure).map_err(|e| fault.io("setting the exposure", &e))?;
    if let (Some(c), Some(gain)) = (config.gain, raw.gain) {
        sys::set_control(device, c.id, gain).map_err(|e| fault.io("setting the gain", &e))?;
    }
    Ok(())
}

/// Reads exposure and gain.
pub fn read(device: &Device, config: &V4l2Config) -> Result<RawSettings> {
    let fault = Fault(&config.name);
    let exposure =
        sys::get_control(device, config.exposure.id).map_err(|e| fault.io("reading the exposure back", &e))?;
    let gain = match config.gain {
        Some(c) => Some(sys::get_control(device, c.id).map_err(|e| fault.io("reading the gain back", &e))?),
        None => None,
    };
    Ok(RawSettings { exposure, gain })
}

/// Sets the frame interval and returns what the device made of it; `None` for a device without that setting.
pub fn set_interval(device: &Device, seconds: f64) -> io::Result<Option<f64>> {
    // A tenth of a millisecond is fine enough for an interval, and its fraction fits 32 bits for days.
    let ticks = (seconds * 1e4).ceil().clamp(1.0, f64::from(u32::MAX)) as u32;
    match device.set_params(&Parameters::new(Fraction::new(ticks, 10_000))) {
        Ok(now) if now.interval.denominator > 0 => {
            Ok(Some(f64::from(now.interval.numerator) / f64::from(now.interval.denominator)))
        }
        Ok(_) => Ok(None),
        Err(e) if matches!(e.raw_os_error(), Some(libc::EINVAL | libc::ENOTTY)) => Ok(None),
        Err(e) => Err(e),
    }
}
