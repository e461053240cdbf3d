//! The drivers, one device a file (the Zaber one with its codec, warnings and chain beside it).

#[cfg(feature = "aravis")]
pub mod aravis;
pub mod camera;
pub mod cm110_wire;
mod esp301_bus;
pub mod esp301_protocol;
pub mod lamp;
pub mod lcus_relay;
mod line_wire;
pub mod newport_1830c;
pub mod newport_esp301;
pub mod newport_smc100;
pub mod oceanoptics;
pub mod oceanoptics_protocol;
mod oceanoptics_scale;
mod open_loop;
pub mod operator;
pub mod optec_ifw;
mod prompt;
pub mod smc100_protocol;
pub mod spectral_cm110;
pub mod thorlabs_fw212c;
pub mod thorlabs_pm100;
mod thorlabs_pm100_text;
pub mod thorlabs_sc10;
pub mod uniblitz_vcm_d1;
pub mod usbtmc;
#[cfg(feature = "v4l2")]
pub mod v4l2;
pub mod zaber_ascii;
mod zaber_chain;
pub mod zaber_protocol;
pub mod zaber_warning;

pub use camera::CameraConfig;
pub use esp301_bus::Esp301;
pub use newport_1830c::Newport1830c;
pub use newport_esp301::Esp301Axis;
pub use newport_smc100::{Smc100, Smc100Axis};
pub use oceanoptics::OceanOptics;
pub use optec_ifw::OptecIfw;
pub use spectral_cm110::Cm110;
pub use thorlabs_fw212c::Fw212c;
pub use thorlabs_pm100::Pm100;
pub use thorlabs_sc10::{Sc10, ShutterConfig};
pub use zaber_ascii::ZaberAxis;
pub use zaber_chain::ZaberChain;

use crate::units::{Degrees, DegreesPerSecond, Nanometres, Slot};
use std::time::Duration;

/// One rotation axis as the instrument file says it. All angles are angles of the axis itself: the mechanical zero of
/// the table is added by the plan, not here.
#[derive(Debug, Clone, PartialEq)]
pub struct AxisConfig {
    /// Name in the instrument file (`tilt`, `spin`, `changer`).
    pub name: String,
    /// Device number in the chain, from 1.
    pub device: u8,
    /// Axis number of the device, from 1.
    pub axis: u8,
    /// Serial number that the device must report.
    pub serial: String,
    /// Lowest angle that may be commanded.
    pub min: Degrees,
    /// Highest angle that may be commanded.
    pub max: Degrees,
    /// Speed; written to the device.
    pub speed: DegreesPerSecond,
    /// Acceleration; written to the device.
    pub acceleration_deg_per_s2: f64,
    /// Largest accepted difference between commanded and read position.
    pub tolerance: Degrees,
    /// Wait after the axis stands.
    pub settle: Duration,
}

// === impl AxisConfig ===

impl AxisConfig {
    /// Time of a trapezoid over `distance` with the configured speed and acceleration (0 = no ramps).
    pub(crate) fn travel(&self, distance: Degrees) -> Duration {
        let (v, a) = (self.speed.0, self.acceleration_deg_per_s2);
        let seconds = if a <= 0.0 {
            distance.0 / v
        } else if distance.0 * a < v * v {
            2.0 * (distance.0 / a).sqrt()
        } else {
            distance.0 / v + v / a
        };
        Duration::try_from_secs_f64(seconds).unwrap_or(Duration::from_secs(3))
    }

    /// Why `target` may not be commanded by the instrument file; `None` where it may.
    pub fn beyond(&self, target: Degrees) -> Option<String> {
        let (min, max) = (self.min, self.max);
        let within = target.0 >= min.0 && target.0 <= max.0;
        (!within).then(|| {
            format!("{target} is outside the soft limits {min} to {max} of the instrument file; nothing was sent")
        })
    }

    /// What is wrong with where the axis came to stand; `None` within the tolerance.
    pub fn missed(&self, target: Degrees, reached: Degrees) -> Option<String> {
        let within = reached.distance(target).0 <= self.tolerance.0;
        (!within).then(|| {
            let tolerance = self.tolerance;
            format!(
                "stands at {reached} instead of {target} (tolerance {tolerance}); check that nothing blocks the stage"
            )
        })
    }
}

/// What the instrument file says about a filter wheel.
#[derive(Debug, Clone, PartialEq)]
pub struct WheelConfig {
    /// Name in the instrument file.
    pub name: String,
    /// Places that the wheel must report.
    pub places: u8,
    /// The blank place, where there is one: the wheel's safe state.
    pub dark: Option<Slot>,
    /// Wait after arrival.
    pub settle: Duration,
}

// === impl WheelConfig ===

impl WheelConfig {
    /// Why `slot` cannot be selected; `None` where the wheel has it.
    pub fn beyond(&self, slot: Slot) -> Option<String> {
        let within = (1..=self.places).contains(&slot.0);
        (!within).then(|| format!("{slot} does not exist, the wheel has slots 1 to {}; nothing was sent", self.places))
    }

    /// What there is to say of a wheel that was last commanded to one place and stands at another.
    pub fn astray(commanded: Option<u8>, stands: Option<u8>) -> Option<String> {
        match (commanded, stands) {
            (Some(was), Some(is)) if was != is => Some(format!("moved by hand from slot {was} to slot {is}")),
            (_, None) => Some("the wheel tells no place".to_owned()),
            _ => None,
        }
    }
}

/// What the instrument file says about a monochromator.
#[derive(Debug, Clone, PartialEq)]
pub struct MonochromatorConfig {
    /// Name in the instrument file.
    pub name: String,
    /// Serial number the device must report; empty where it is not checked.
    pub serial: String,
    /// Shortest wavelength that may be commanded.
    pub min: Nanometres,
    /// Longest wavelength that may be commanded.
    pub max: Nanometres,
    /// Largest accepted difference between commanded and read wavelength.
    pub tolerance: Nanometres,
    /// Wait after the grating stands.
    pub settle: Duration,
}

/// What the instrument file says about a light monitor.
#[derive(Debug, Clone, PartialEq)]
pub struct LightMonitorConfig {
    /// Name in the instrument file.
    pub name: String,
    /// Serial number the device must report; empty where it has none to tell or it is not checked.
    pub serial: String,
    /// Wavelength of the responsivity correction.
    pub wavelength: Nanometres,
    /// Readings the device averages into one.
    pub average: u32,
}

/// What the instrument file says about a spectrometer.
#[derive(Debug, Clone, PartialEq)]
pub struct SpectrometerConfig {
    /// Name in the instrument file.
    pub name: String,
    /// Serial number the device must report.
    pub serial: String,
}
