//! The driver table: one line a driver of this crate. A new device is one file in [`devices`](crate::devices) and one line here.

use crate::clock::Clock;
use crate::contract::{Camera, FilterWheel, LightMonitor, Monochromator, RotaryAxis, Shutter, Spectrometer};
use crate::devices::{
    AxisConfig, CameraConfig, Fw212c, LightMonitorConfig, MonochromatorConfig, Sc10, ShutterConfig, SpectrometerConfig,
    WheelConfig, ZaberChain, thorlabs_fw212c, thorlabs_sc10,
};
use crate::error::{DeviceError, ErrorKind, Result};
use crate::transport::{Connector, UsbConnector};

/// Makes all axes of a holder that share one link, in the order given.
pub type MakeHolder = fn(Box<dyn Connector>, Vec<AxisConfig>, Clock) -> Vec<Box<dyn RotaryAxis>>;
/// Makes a filter wheel.
pub type MakeWheel = fn(Box<dyn Connector>, WheelConfig, Clock) -> Box<dyn FilterWheel>;
/// Makes a shutter.
pub type MakeShutter = fn(Box<dyn Connector>, ShutterConfig, Clock) -> Box<dyn Shutter>;

/// Makes a monochromator.
pub type MakeMonochromator = fn(Box<dyn Connector>, MonochromatorConfig, Clock) -> Box<dyn Monochromator>;
/// Makes a light monitor on a serial line.
pub type MakeLightMonitor = fn(Box<dyn Connector>, LightMonitorConfig, Clock) -> Box<dyn LightMonitor>;
/// Makes a light monitor on USB.
pub type MakeUsbLightMonitor = fn(Box<dyn UsbConnector>, LightMonitorConfig, Clock) -> Box<dyn LightMonitor>;
/// Makes a spectrometer on USB.
pub type MakeSpectrometer = fn(Box<dyn UsbConnector>, SpectrometerConfig, Clock) -> Box<dyn Spectrometer>;

/// Makes a camera; `Refused` where its configuration asks for what the driver cannot do.
pub type MakeCamera = fn(CameraConfig, Clock) -> Result<Box<dyn Camera>>;

/// What a driver drives, and how it is made. Making sends nothing; `open` does.
#[derive(Clone, Copy)]
pub enum Make {
    /// Rotation axes of a sample holder.
    Holder(MakeHolder),
    /// A filter wheel.
    FilterWheel(MakeWheel),
    /// A shutter.
    Shutter(MakeShutter),
    /// A monochromator.
    Monochromator(MakeMonochromator),
    /// A light monitor on a serial line.
    LightMonitor(MakeLightMonitor),
    /// A light monitor on USB.
    UsbLightMonitor(MakeUsbLightMonitor),
    /// A spectrometer on USB.
    Spectrometer(MakeSpectrometer),
    /// A camera.
    Camera(MakeCamera),
}

/// One driver.
#[derive(Clone, Copy)]
pub struct Driver {
    /// Name in instrument files.
    pub name: &'static str,
    /// Devices it speaks to.
    pub devices: &'static str,
    /// Baud rate of the serial line; 0 for a device on another link.
    pub baud: u32,
    /// Kind and constructor.
    pub make: Make,
}

/// All drivers.
#[rustfmt::skip]
pub const DRIVERS: &[Driver] = &[
    Driver { name: "zaber-ascii", devices: "Zaber rotary stages, ASCII protocol, firmware 6.14 to 7.x", baud: 115_200, make: Make::Holder(zaber) },
    Driver { name: "thorlabs-fw212c", devices: "Thorlabs FW212C and FW102C filter wheels", baud: thorlabs_fw212c::BAUD, make: Make::FilterWheel(|c, w, k| Box::new(Fw212c::new(c, w, k))) },
    Driver { name: "thorlabs-sc10", devices: "Thorlabs SC10 shutter controller", baud: thorlabs_sc10::BAUD, make: Make::Shutter(|c, s, k| Box::new(Sc10::new(c, s, k))) },
    #[cfg(feature = "v4l2")]
    Driver { name: "v4l2", devices: "cameras behind any V4L2 node", baud: 0, make: Make::Camera(crate::devices::v4l2::make) },
    #[cfg(feature = "aravis")]
    Driver { name: "aravis", devices: "GigE Vision and USB3 Vision cameras", baud: 0, make: Make::Camera(crate::devices::aravis::make) },
];

/// Drivers that not every build has, with the feature that brings them.
pub const BY_FEATURE: &[(&str, &str)] =
    &[("v4l2", "v4l2"), ("aravis", "aravis"), ("sim-ccd", "sim"), ("sim-ingaas", "sim")];

fn zaber(connector: Box<dyn Connector>, axes: Vec<AxisConfig>, clock: Clock) -> Vec<Box<dyn RotaryAxis>> {
    let chain = ZaberChain::new(connector, axes, clock);
    chain.axes().into_iter().map(|axis| Box::new(axis) as Box<dyn RotaryAxis>).collect()
}

/// The feature that brings the driver called `name`, where not every build has it.
pub fn feature_of(name: &str) -> Option<&'static str> {
    BY_FEATURE.iter().find(|(driver, _)| *driver == name).map(|(_, feature)| *feature)
}

/// The driver called `name`; `Refused` lists the known ones.
pub fn lookup(name: &str) -> Result<&'static Driver> {
    DRIVERS.iter().find(|d| d.name == name).ok_or_else(|| {
        if let Some(feature) = feature_of(name) {
            let message = format!("this build lacks the driver `{name}`; build it with `--features {feature}`");
            return DeviceError::new(ErrorKind::Refused, name, message);
        }
        let known: Vec<&str> = DRIVERS.iter().map(|d| d.name).collect();
        DeviceError::new(
            ErrorKind::Refused,
            name,
            format!("no driver `{name}` is known; there are: {}", known.join(", ")),
        )
    })
}

/// Makes the axes of a holder with the driver called `name`.
pub fn holder(
    name: &str,
    connector: Box<dyn Connector>,
    axes: Vec<AxisConfig>,
    clock: Clock,
) -> Result<Vec<Box<dyn RotaryAxis>>> {
    match lookup(name)?.make {
        Make::Holder(make) => Ok(make(connector, axes, clock)),
        _ => Err(wrong_kind(name, "a sample holder")),
    }
}

/// Makes a filter wheel with the driver called `name`.
pub fn filter_wheel(
    name: &str,
    connector: Box<dyn Connector>,
    config: WheelConfig,
    clock: Clock,
) -> Result<Box<dyn FilterWheel>> {
    match lookup(name)?.make {
        Make::FilterWheel(make) => Ok(make(connector, config, clock)),
        _ => Err(wrong_kind(name, "a filter wheel")),
    }
}

/// Makes a shutter with the driver called `name`.
pub fn shutter(
    name: &str,
    connector: Box<dyn Connector>,
    config: ShutterConfig,
    clock: Clock,
) -> Result<Box<dyn Shutter>> {
    match lookup(name)?.make {
        Make::Shutter(make) => Ok(make(connector, config, clock)),
        _ => Err(wrong_kind(name, "a shutter")),
    }
}

/// Makes a camera with the driver called `name`; it proves at every opening that it is what `config` says.
pub fn camera(name: &str, config: CameraConfig, clock: Clock) -> Result<Box<dyn Camera>> {
    match lookup(name)?.make {
        Make::Camera(make) => make(config, clock),
        _ => Err(wrong_kind(name, "a camera")),
    }
}

fn wrong_kind(name: &str, wanted: &str) -> DeviceError {
    DeviceError::new(ErrorKind::Refused, name, format!("driver `{name}` does not drive {wanted}"))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used)]
    use super::*;

    #[test]
    fn an_unknown_driver_is_answered_with_the_known_ones() {
        let error = lookup("zaber-binary").err().unwrap();
        assert_eq!(error.kind, ErrorKind::Refused);
        for driver in DRIVERS {
            assert!(error.message.contains(driver.name), "{error}");
            assert_eq!(lookup(driver.name).unwrap().baud, driver.baud);
        }
    }

    #[test]
    fn a_driver_of_another_build_names_its_feature() {
        for (name, feature) in BY_FEATURE {
            match lookup(name) {
                Ok(driver) => assert_eq!(driver.name, *name),
                Err(error) => assert!(error.message.contains(&format!("--features {feature}")), "{error}"),
            }
        }
    }
}
