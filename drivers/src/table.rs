//! The driver table: one line a driver of this crate. A new device is one file in [`devices`](crate::devices) and one line here.

use crate::clock::Clock;
use crate::contract::{Camera, FilterWheel, LightMonitor, Monochromator, RotaryAxis, Shutter, Spectrometer};
use crate::devices::{
    AxisConfig, CameraConfig, Cm110, Esp301, Fw212c, LightMonitorConfig, MonochromatorConfig, Newport1830c,
    OceanOptics, OptecIfw, Pm100, Sc10, ShutterConfig, Smc100, SpectrometerConfig, WheelConfig, ZaberChain, lcus_relay,
    newport_1830c, newport_esp301, newport_smc100, oceanoptics_protocol, optec_ifw, spectral_cm110, thorlabs_fw212c,
    thorlabs_pm100, thorlabs_sc10, uniblitz_vcm_d1,
};
use crate::error::{DeviceError, ErrorKind, Result};
use crate::transport::{Connector, FlowControl, UsbConnector};

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
    Driver { name: "newport-esp301", devices: "rotation stages on a Newport ESP301, USB", baud: newport_esp301::BAUD, make: Make::Holder(esp301) },
    Driver { name: "newport-esp300", devices: "rotation stages on a Newport ESP300 or ESP301, RS-232", baud: newport_esp301::BAUD_RS232, make: Make::Holder(esp301) },
    Driver { name: "newport-smc100", devices: "rotation stages on Newport SMC100 boxes", baud: newport_smc100::BAUD, make: Make::Holder(smc100) },
    Driver { name: "thorlabs-fw212c", devices: "Thorlabs FW212C and FW102C filter wheels", baud: thorlabs_fw212c::BAUD, make: Make::FilterWheel(|c, w, k| Box::new(Fw212c::new(c, w, k))) },
    Driver { name: "optec-ifw", devices: "Optec IFW, IFW2 and IFW3 filter wheels", baud: optec_ifw::BAUD, make: Make::FilterWheel(|c, w, k| Box::new(OptecIfw::new(c, w, k))) },
    Driver { name: "thorlabs-sc10", devices: "Thorlabs SC10 shutter controller", baud: thorlabs_sc10::BAUD, make: Make::Shutter(|c, s, k| Box::new(Sc10::new(c, s, k))) },
    Driver { name: "uniblitz-vcm-d1", devices: "Uniblitz VCM-D1, VMM-D1 and VMM-T1 shutter drivers, no feedback", baud: uniblitz_vcm_d1::BAUD, make: Make::Shutter(uniblitz_vcm_d1::shutter) },
    Driver { name: "lcus-relay", devices: "LCUS USB relay boards with a shutter on channel 1, no feedback", baud: lcus_relay::BAUD, make: Make::Shutter(lcus_relay::shutter) },
    Driver { name: "spectral-cm110", devices: "Spectral Products CM110 and CM112 monochromators", baud: spectral_cm110::BAUD, make: Make::Monochromator(|c, m, k| Box::new(Cm110::new(c, m, k))) },
    Driver { name: "thorlabs-pm100", devices: "Thorlabs PM100D, PM100A and PM100USB power meters", baud: 0, make: Make::UsbLightMonitor(|c, m, k| Box::new(Pm100::new(c, m, k))) },
    Driver { name: "newport-1830c", devices: "Newport 1830-C power meter as light monitor", baud: newport_1830c::BAUD, make: Make::LightMonitor(|c, m, k| Box::new(Newport1830c::new(c, m, k))) },
    Driver { name: "oceanoptics-usb", devices: "Ocean Optics USB2000, USB2000+ and USB4000 spectrometers", baud: 0, make: Make::Spectrometer(|c, s, k| Box::new(OceanOptics::new(c, s, k))) },
    #[cfg(feature = "v4l2")]
    Driver { name: "v4l2", devices: "cameras behind any V4L2 node", baud: 0, make: Make::Camera(crate::devices::v4l2::make) },
    #[cfg(feature = "aravis")]
    Driver { name: "aravis", devices: "GigE Vision and USB3 Vision cameras", baud: 0, make: Make::Camera(crate::devices::aravis::make) },
];

/// Drivers that not every build has, with the feature that brings them.
pub const BY_FEATURE: &[(&str, &str)] =
    &[("v4l2", "v4l2"), ("aravis", "aravis"), ("sim-ccd", "sim"), ("sim-ingaas", "sim")];

/// Vendor and product ids of the USB devices that a driver of the table opens through libusb; empty for all others.
pub fn usb_ids(name: &str) -> Vec<(u16, u16)> {
    match name {
        "thorlabs-pm100" => thorlabs_pm100::IDS.to_vec(),
        "oceanoptics-usb" => {
            oceanoptics_protocol::MODELS.iter().map(|m| (oceanoptics_protocol::VENDOR, m.product)).collect()
        }
        _ => Vec::new(),
    }
}

/// Flow control of a driver's serial line, where the instrument file says nothing else: the ESP300's RS-232 port wants
/// RTS and CTS by its manual, the SMC100 XON and XOFF; all others have none.
pub fn flow_control(name: &str) -> FlowControl {
    match name {
        "newport-esp300" => FlowControl::RtsCts,
        "newport-smc100" => FlowControl::XonXoff,
        _ => FlowControl::None,
    }
}

fn zaber(connector: Box<dyn Connector>, axes: Vec<AxisConfig>, clock: Clock) -> Vec<Box<dyn RotaryAxis>> {
    let chain = ZaberChain::new(connector, axes, clock);
    chain.axes().into_iter().map(|axis| Box::new(axis) as Box<dyn RotaryAxis>).collect()
}

/// The feature that brings the driver called `name`, where not every build has it.
pub fn feature_of(name: &str) -> Option<&'static str> {
    BY_FEATURE.iter().find(|(driver, _)| *driver == name).map(|(_, feature)| *feature)
}

fn esp301(connector: Box<dyn Connector>, axes: Vec<AxisConfig>, clock: Clock) -> Vec<Box<dyn RotaryAxis>> {
    let controller = Esp301::new(connector, axes, clock);
    controller.axes().into_iter().map(|axis| Box::new(axis) as Box<dyn RotaryAxis>).collect()
}

fn smc100(connector: Box<dyn Connector>, axes: Vec<AxisConfig>, clock: Clock) -> Vec<Box<dyn RotaryAxis>> {
    let chain = Smc100::new(connector, axes, clock);
    chain.axes().into_iter().map(|axis| Box::new(axis) as Box<dyn RotaryAxis>).collect()
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

/// Makes a monochromator with the driver called `name`.
pub fn monochromator(
    name: &str,
    connector: Box<dyn Connector>,
    config: MonochromatorConfig,
    clock: Clock,
) -> Result<Box<dyn Monochromator>> {
    match lookup(name)?.make {
        Make::Monochromator(make) => Ok(make(connector, config, clock)),
        _ => Err(wrong_kind(name, "a monochromator")),
    }
}

/// Makes a light monitor on a serial line with the driver called `name`.
pub fn light_monitor(
    name: &str,
    connector: Box<dyn Connector>,
    config: LightMonitorConfig,
    clock: Clock,
) -> Result<Box<dyn LightMonitor>> {
    match lookup(name)?.make {
        Make::LightMonitor(make) => Ok(make(connector, config, clock)),
        _ => Err(wrong_kind(name, "a light monitor on a serial line")),
    }
}

/// Makes a light monitor on USB with the driver called `name`.
pub fn usb_light_monitor(
    name: &str,
    connector: Box<dyn UsbConnector>,
    config: LightMonitorConfig,
    clock: Clock,
) -> Result<Box<dyn LightMonitor>> {
    match lookup(name)?.make {
        Make::UsbLightMonitor(make) => Ok(make(connector, config, clock)),
        _ => Err(wrong_kind(name, "a light monitor on USB")),
    }
}

/// Makes a spectrometer with the driver called `name`.
pub fn spectrometer(
    name: &str,
    connector: Box<dyn UsbConnector>,
    config: SpectrometerConfig,
    clock: Clock,
) -> Result<Box<dyn Spectrometer>> {
    match lookup(name)?.make {
        Make::Spectrometer(make) => Ok(make(connector, config, clock)),
        _ => Err(wrong_kind(name, "a spectrometer")),
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
