//! A driver of the table on the twin of its device, ready to be tried.

use super::stand::{Plug, SerialStand, Stand, UsbStand};
use super::truth;
use crate::firmware::cm110::{Cm110Twin, MonochromatorSpec};
use crate::firmware::newport_1830c::Newport1830cTwin;
use crate::firmware::usb::oceanoptics::{OceanModel, OceanSpec, OceanTwin};
use crate::firmware::usb::pm100::{Pm100Spec, Pm100Twin};
use crate::truth::error::{Result, SimError};
use crate::truth::lamp::SimLamp;
use crate::twins::TwinsSpec;
use goniod_drivers::clock::Clock;
use goniod_drivers::conformance::Subject;
use goniod_drivers::devices::{
    AxisConfig, LightMonitorConfig, MonochromatorConfig, ShutterConfig, SpectrometerConfig, WheelConfig,
};
use goniod_drivers::table::{Driver, Make};
use goniod_drivers::units::{Degrees, DegreesPerSecond, Nanometres, Slot};
use std::time::Duration;
use tokio::time::Instant;

/// Which unit stands on the stand.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Unit {
    /// The one that the configuration names.
    Ours,
    /// The same model with another serial number, or another number of places.
    Another,
}

/// A driver on its device.
pub struct Rig {
    /// The driver.
    pub subject: Subject,
    /// The device.
    pub stand: Box<dyn Stand>,
    /// The device answers: false for one that only listens.
    pub answers: bool,
    /// Answers that are left alone between two disturbed ones, at least. A driver whose line has no checksum and whose
    /// values change (a light monitor) takes the median of three: two disturbed ones in three are beyond it.
    pub clean_answers: u64,
}

/// Light on the monitors, watts.
const LIGHT_W: f64 = 1e-3;
/// Disturbed answers that the median of three bears: one in six.
const CLEAN_FOR_A_MEDIAN: u64 = 5;

/// The rig of a driver; `None` where a unit cannot tell which one it is.
///
/// # Errors
/// [`SimError::Unknown`]: a driver without a twin.
pub fn rig(driver: &Driver, unit: Unit, clock: Clock) -> Result<Option<Rig>> {
    let Some(stand) = stand(driver, unit)? else { return Ok(None) };
    let subject = subject(driver, stand.plug(clock), clock)?;
    let answers = !["uniblitz-vcm-d1", "lcus-relay"].contains(&driver.name);
    let clean_answers = if driver.name == "newport-1830c" { CLEAN_FOR_A_MEDIAN } else { 0 };
    Ok(Some(Rig { subject, stand, answers, clean_answers }))
}

/// The device of a driver on its stand; `None` where a unit cannot tell which one it is.
///
/// # Errors
/// [`SimError::Unknown`]: a driver without a twin.
pub fn stand(driver: &Driver, unit: Unit) -> Result<Option<Box<dyn Stand>>> {
    let now = Instant::now();
    let ours = unit == Unit::Ours;
    let serial = |is: &'static str| if ours { is } else { "7777" };
    let mut spec = TwinsSpec::with_serials(serial("1001"), serial("1002"), serial("1003"));
    let known = ["zaber-ascii", "thorlabs-fw212c", "thorlabs-sc10"];
    let with = |spec: TwinsSpec, place: usize| {
        let mut names = known;
        if let Some(name) = names.get_mut(place) {
            *name = driver.name;
        }
        spec.with_drivers(names)
    };
    Ok(Some(match driver.make {
        Make::Holder(_) => Box::new(SerialStand::new(with(spec, 0)?.holder(now), truth::holder())),
        Make::FilterWheel(_) => {
            let places = places(driver.name);
            spec.wheel.places = if ours {
                places
            } else if places == 12 {
                6
            } else {
                5
            };
            Box::new(SerialStand::new(with(spec, 1)?.wheel(now), truth::wheel()))
        }
        Make::Shutter(_) if !ours => return Ok(None),
        Make::Shutter(_) => {
            let feedback = driver.name == "thorlabs-sc10";
            Box::new(SerialStand::new(with(spec, 2)?.shutter(now), truth::shutter(feedback)))
        }
        Make::Monochromator(_) if driver.name == "spectral-cm110" => {
            let spec = MonochromatorSpec { serial: if ours { 11_042 } else { 7777 }, ..MonochromatorSpec::default() };
            Box::new(SerialStand::new(Cm110Twin::new(spec, now), truth::monochromator()))
        }
        Make::LightMonitor(_) if !ours => return Ok(None),
        Make::LightMonitor(_) if driver.name == "newport-1830c" => {
            let twin = Newport1830cTwin::new(SimLamp::steady(LIGHT_W, now), now);
            Box::new(SerialStand::new(twin, truth::light_monitor()))
        }
        Make::UsbLightMonitor(_) if driver.name == "thorlabs-pm100" => {
            let twin = Pm100Twin::new(Pm100Spec::new(serial("P0001234")));
            Box::new(UsbStand::new(twin, truth::usb_light_monitor()))
        }
        Make::Spectrometer(_) if driver.name == "oceanoptics-usb" => {
            let twin = OceanTwin::new(OceanSpec::new(OceanModel::Usb2000, serial("USB2G1234")), now);
            Box::new(UsbStand::new(twin, truth::spectrometer()))
        }
        _ => return Err(no_twin(driver.name)),
    }))
}

/// The driver over a plug, configured for [`Unit::Ours`].
///
/// # Errors
/// [`SimError::Unknown`]: a driver that does not speak over such a plug.
pub fn subject(driver: &Driver, plug: Plug, clock: Clock) -> Result<Subject> {
    let (millis, name) = (Duration::from_millis, |name: &str| name.to_owned());
    let monitor = |serial: &str| LightMonitorConfig {
        name: name("light_monitor"),
        serial: name(serial),
        wavelength: Nanometres(550.0),
        average: 4,
    };
    Ok(match (driver.make, plug) {
        (Make::Holder(make), Plug::Serial(connector)) => {
            let axis = make(connector, vec![axis()], clock).into_iter().next();
            Subject::Axis(axis.ok_or_else(|| no_twin(driver.name))?)
        }
        (Make::FilterWheel(make), Plug::Serial(connector)) => {
            let places = places(driver.name);
            let config = WheelConfig { name: name("wheel"), places, dark: Some(Slot(places)), settle: millis(100) };
            Subject::Wheel(make(connector, config, clock))
        }
        (Make::Shutter(make), Plug::Serial(connector)) => {
            Subject::Shutter(make(connector, ShutterConfig { name: name("shutter"), settle: millis(50) }, clock))
        }
        (Make::Monochromator(make), Plug::Serial(connector)) => {
            let config = MonochromatorConfig {
                name: name("monochromator"),
                serial: name("11042"),
                min: Nanometres(300.0),
                max: Nanometres(1100.0),
                tolerance: Nanometres(0.2),
                settle: millis(100),
            };
            Subject::Monochromator(make(connector, config, clock))
        }
        (Make::LightMonitor(make), Plug::Serial(connector)) => {
            Subject::LightMonitor(make(connector, monitor(""), clock))
        }
        (Make::UsbLightMonitor(make), Plug::Usb(connector)) => {
            Subject::LightMonitor(make(connector, monitor("P0001234"), clock))
        }
        (Make::Spectrometer(make), Plug::Usb(connector)) => {
            let config = SpectrometerConfig { name: name("spectrometer"), serial: name("USB2G1234") };
            Subject::Spectrometer(make(connector, config, clock))
        }
        _ => return Err(no_twin(driver.name)),
    })
}

/// 10 degrees a second, 20 degrees a second squared; the first axis of the first device in every holder.
fn axis() -> AxisConfig {
    AxisConfig {
        name: "tilt".into(),
        device: 1,
        axis: 1,
        serial: "1001".into(),
        min: Degrees(-5.0),
        max: Degrees(365.0),
        speed: DegreesPerSecond(10.0),
        acceleration_deg_per_s2: 20.0,
        tolerance: Degrees(0.01),
        settle: Duration::from_millis(200),
    }
}

/// An Optec wheel has nine places at most.
fn places(driver: &str) -> u8 {
    if driver == "optec-ifw" { 9 } else { 12 }
}

fn no_twin(driver: &str) -> SimError {
    let known = crate::twins::DRIVERS.concat().join(", ");
    SimError::Unknown { what: "twin for the driver", name: driver.to_owned(), known }
}
