//! Opening a camera: identity, control, every feature written and read back.

use super::features::Features;
use super::options::{AravisOptions, Trigger};
use crate::contract::{CameraInfo, Identity};
use crate::error::{DeviceError, ErrorKind, Result};
use crate::units::ExposureTime;
use aravis::glib::object::Cast;
use aravis::prelude::*;
use aravis::{AccessCheckPolicy, Camera, GvDevice, GvStreamOption, RangeCheckPolicy, RegisterCachePolicy};
use std::time::Duration;

/// How often and how long to ask for control: a camera keeps a vanished controller for its heartbeat time.
const CONTROL_TRIES: u32 = 20;
const CONTROL_PAUSE: Duration = Duration::from_millis(200);

/// A camera that is open, proven and configured, not yet running.
pub struct Opened {
    /// The library's camera.
    pub camera: Camera,
    /// Its features.
    pub features: Features,
    /// What it is.
    pub info: CameraInfo,
    /// Name of the integration time's feature.
    pub exposure: &'static str,
    /// Name of the gain's feature; `None` where the camera has none.
    pub gain: Option<&'static str>,
    /// What the operator should know about the link.
    pub warnings: Vec<String>,
}

/// Opens the camera at `options.address`.
///
/// # Errors
/// `Lost` where nobody answers or another program holds the camera, `WrongDevice` for another serial number, format or
/// size, `Broken` where a feature does not read back.
pub fn open(options: &AravisOptions) -> Result<Opened> {
    let label = options.label();
    let camera = Camera::new(Some(&options.address)).map_err(|e| {
        let message = format!("no camera answers: {}; check power, cable, address and firewall", e.message());
        DeviceError::new(ErrorKind::Lost, label.clone(), message)
    })?;
    let device = camera
        .device()
        .ok_or_else(|| DeviceError::new(ErrorKind::Lost, label.clone(), "the camera library gives no device"))?;
    // Off by default: without them out-of-range values and read-only features are accepted in silence.
    device.set_range_check_policy(RangeCheckPolicy::Enable);
    device.set_access_check_policy(AccessCheckPolicy::Enable);
    // A read-back must come from the camera.
    device.set_register_cache_policy(RegisterCachePolicy::Disable);
    let features = Features::new(device, label);
    let identity = identify(&features, options)?;
    take_control(&features)?;
    let warnings = prepare_link(&camera, &features, options)?;
    let (exposure, gain) = configure(&features, options)?;
    let (shortest, longest) = features
        .device()
        .float_feature_bounds(exposure)
        .map_err(|e| features.wrap("reading the range of the integration time", &e))?;
    let info = CameraInfo {
        identity,
        width: options.width,
        height: options.height,
        format: options.format.frame_format(),
        shortest: ExposureTime(shortest.ceil().max(0.0) as u64),
        longest: ExposureTime(longest.floor().max(0.0) as u64),
    };
    Ok(Opened { camera, features, info, exposure, gain, warnings })
}

fn identify(features: &Features, options: &AravisOptions) -> Result<Identity> {
    let read = |names: &[&str]| features.first(names).map_or(Ok(String::new()), |name| features.text(name));
    let identity = Identity {
        model: read(&["DeviceModelName"])?,
        firmware: read(&["DeviceFirmwareVersion", "DeviceVersion"])?,
        serial: read(&["DeviceSerialNumber", "DeviceID"])?,
    };
    if identity.serial == options.serial {
        return Ok(identity);
    }
    let message = format!(
        "the camera there has serial number {:?}, the instrument file names {:?}; correct one of them",
        identity.serial, options.serial
    );
    Err(features.fail(ErrorKind::WrongDevice, message))
}

/// Control of a GigE camera, waited for while it still believes in a controller that is gone.
fn take_control(features: &Features) -> Result<()> {
    let Some(gv) = features.device().downcast_ref::<GvDevice>() else { return Ok(()) };
    for _ in 0..CONTROL_TRIES {
        // The library's own flag stays up until its next heartbeat; the register tells the truth.
        if gv.is_controller() || gv.take_control().is_ok() && gv.is_controller() {
            return Ok(());
        }
        std::thread::park_timeout(CONTROL_PAUSE);
    }
    Err(features
        .fail(ErrorKind::Lost, "another program controls the camera; end it, or wait for its heartbeat to pass"))
}

/// Heartbeat, packet size and delay of a GigE link; what the receiving side may lack.
fn prepare_link(camera: &Camera, features: &Features, options: &AravisOptions) -> Result<Vec<String>> {
    let Some(gv) = features.device().downcast_ref::<GvDevice>() else { return Ok(Vec::new()) };
    if features.has("GevHeartbeatTimeout") {
        features.set_integer("GevHeartbeatTimeout", options.heartbeat.as_millis() as i64)?;
    }
    let size = options.packet_size as i32;
    camera.gv_set_packet_size(size).map_err(|e| features.wrap("setting the packet size", &e))?;
    if options.packet_delay_ns > 0 {
        let delay = i64::from(options.packet_delay_ns);
        camera.gv_set_packet_delay(delay).map_err(|e| features.wrap("setting the packet delay", &e))?;
    }
    // A packet socket hears the whole host until its filter is set: packets of another camera came into our frames.
    gv.set_stream_options(GvStreamOption::PACKET_SOCKET_DISABLED);
    let granted = largest_socket_buffer();
    let mut warnings = Vec::new();
    if let Some(bytes) = granted.filter(|bytes| *bytes < i64::from(options.socket_buffer_bytes)) {
        warnings.push(format!(
            "the kernel grants {bytes} bytes of socket buffer of {} wanted: raise net.core.rmem_max",
            options.socket_buffer_bytes
        ));
    }
    Ok(warnings)
}

fn largest_socket_buffer() -> Option<i64> {
    std::fs::read_to_string("/proc/sys/net/core/rmem_max").ok()?.trim().parse().ok()
}

/// Writes every feature that bears on what a level means and reads it back; gives the names of exposure and gain.
fn configure(f: &Features, options: &AravisOptions) -> Result<(&'static str, Option<&'static str>)> {
    for automatic in ["ExposureAuto", "GainAuto", "BlackLevelAuto", "GammaEnable"] {
        match automatic {
            "GammaEnable" if f.has(automatic) => f.set_switch(automatic, false)?,
            _ if f.has(automatic) => f.set_text(automatic, "Off")?,
            _ => {}
        }
    }
    for (name, entry) in [("ExposureMode", "Timed"), ("AcquisitionMode", "Continuous")] {
        if f.has(name) {
            f.set_text(name, entry)?;
        }
    }
    f.set_text("PixelFormat", options.format.name())?;
    for (name, value) in [("Width", options.width), ("Height", options.height)] {
        f.set_integer(name, value as i64)?;
    }
    for name in ["OffsetX", "OffsetY"] {
        if f.has(name) {
            f.set_integer(name, 0)?;
        }
    }
    configure_trigger(f, options)?;
    if options.chunks && f.has("ChunkModeActive") {
        configure_chunks(f)?;
    }
    let exposure = f
        .first(&["ExposureTime", "ExposureTimeAbs"])
        .and_then(|name| ["ExposureTime", "ExposureTimeAbs"].into_iter().find(|n| *n == name))
        .ok_or_else(|| f.fail(ErrorKind::WrongDevice, "the camera has no integration time in microseconds"))?;
    let gain = ["Gain", "GainAbs"].into_iter().find(|name| f.has(name));
    Ok((exposure, gain))
}

fn configure_trigger(f: &Features, options: &AravisOptions) -> Result<()> {
    if f.has("TriggerSelector") {
        f.set_text("TriggerSelector", "FrameStart")?;
    }
    match options.trigger {
        Trigger::Software => {
            f.set_text("TriggerMode", "On")?;
            f.set_text("TriggerSource", "Software")
        }
        Trigger::FreeRun { frame_rate_hz } => {
            if f.has("TriggerMode") {
                f.set_text("TriggerMode", "Off")?;
            }
            if f.has("AcquisitionFrameRateEnable") {
                f.set_switch("AcquisitionFrameRateEnable", true)?;
            }
            let name = f.first(&["AcquisitionFrameRate", "AcquisitionFrameRateAbs"]);
            name.map_or(Ok(()), |name| f.set_float(name, frame_rate_hz, frame_rate_hz * 0.05).map(|_| ()))
        }
    }
}

fn configure_chunks(f: &Features) -> Result<()> {
    f.set_switch("ChunkModeActive", true)?;
    for chunk in ["ExposureTime", "FrameID"] {
        // A camera may offer chunks without these two; its frames then carry the settings read back.
        if f.set_text("ChunkSelector", chunk).is_ok() {
            f.set_switch("ChunkEnable", true)?;
        }
    }
    Ok(())
}
