//! `instrument.toml`: devices, ports, geometry, cameras, filter slots, limits, safe state.

use super::daemon::Daemon;
use super::night::{Interlocks, Recovery, seconds};
use goniod_drivers::devices::camera::{AravisTable, V4l2Table};
use goniod_drivers::frame::PixelFormat;
use goniod_drivers::transport::FlowControl;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::Duration;

/// The hardware and its settings, as the file says it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Instrument {
    /// Name for reports.
    pub name: String,
    /// Folder that run directories are made in, relative to the working directory.
    pub runs_dir: PathBuf,
    /// Go on with an unfinished run of the same plan instead of beginning a new one.
    #[serde(default)]
    pub auto_resume: bool,
    /// Present when ports named `sim:…` belong to a simulated bench.
    pub simulation: Option<Simulation>,
    /// Lamp spectrum and warm-up.
    pub lamp: Lamp,
    /// Sample holder: tilt, spin and, where there is one, the changer axis.
    pub holder: Holder,
    /// Filter wheel with its slots.
    pub filter_wheel: FilterWheel,
    /// Shutter in the beam.
    pub shutter: Shutter,
    /// Power meter that watches the lamp.
    pub light_monitor: Option<LightMonitor>,
    /// Monochromator of the calibration bench.
    pub monochromator: Option<Monochromator>,
    /// Spectrometer of the calibration bench.
    pub spectrometer: Option<Spectrometer>,
    /// Cameras by name (`ccd`, `ingaas`).
    pub camera: BTreeMap<String, Camera>,
    /// Mirror and collecting optics.
    pub optics: Optics,
    /// Known diffusers for the reference views.
    pub reference: References,
    /// What to do, in which order, to be safe.
    pub safe_state: SafeState,
    /// What is done about failing devices.
    #[serde(default)]
    pub recovery: Recovery,
    /// Conditions under which exposures wait or the run ends; absent = none.
    pub interlocks: Option<Interlocks>,
    /// Where `goniod serve` listens and keeps its queue.
    #[serde(default)]
    pub daemon: Daemon,
}

/// Which simulated bench answers the `sim:…` ports.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Simulation {
    /// The bench's own description (truth), relative to the instrument file.
    pub bench: PathBuf,
    /// Seed of every random draw of the bench.
    pub seed: u64,
}

/// The light source.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Lamp {
    /// Relative spectral power, CSV `wavelength_nm,value`, relative to the instrument file.
    pub spectrum: PathBuf,
    /// Irradiance on the sample plane at normal incidence without filter, 300-1700 nm; absent = ratio mode only.
    pub irradiance_uw_per_cm2: Option<f64>,
    /// Relative standard uncertainty of that irradiance.
    pub irradiance_relative_uncertainty: Option<f64>,
    /// Relative standard uncertainty of the lamp's steadiness between two reference views.
    pub drift_relative_uncertainty: f64,
    /// Shortest time from ignition to steady light.
    pub warm_up_s: Option<f64>,
    /// Cooling before it may be struck again.
    pub restrike_s: Option<f64>,
    /// Hours the maker rates it for.
    pub rated_hours: Option<f64>,
    /// Serial number of the lamp that is in; absent = its hours are not counted.
    pub serial: Option<String>,
    /// Hours that this lamp had burnt before its first run here.
    pub hours_at_start: Option<f64>,
}

/// The sample holder.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Holder {
    /// Driver name from the driver table (`zaber-ascii`).
    pub driver: String,
    /// Serial port path, or `sim:holder`.
    pub port: String,
    /// Flow control of the serial line; absent = what the driver's device wants.
    pub flow_control: Option<FlowControl>,
    /// Tilt: polar angle of the source seen from the camera side's normal (0 = reflection at normal incidence, 180 = straight through).
    pub tilt: Axis,
    /// Spin: azimuth of the source in the table's axes.
    pub spin: Axis,
    /// Changer that turns the sample over and presents the references; absent = sample front only, no references.
    pub changer: Option<Changer>,
}

/// One rotation axis.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Axis {
    /// Device number in the chain.
    pub device: u8,
    /// Axis number of the device.
    pub axis: u8,
    /// Serial number the device must report.
    pub serial: String,
    /// Lowest angle that may be commanded.
    pub min_deg: f64,
    /// Highest angle that may be commanded.
    pub max_deg: f64,
    /// Axis angle at which the mechanical zero of the table lies.
    pub zero_deg: f64,
    /// Nominal speed, for forecasts and deadlines.
    pub speed_deg_per_s: f64,
    /// Nominal acceleration.
    pub acceleration_deg_per_s2: f64,
    /// Largest accepted difference between commanded and read position.
    pub tolerance_deg: f64,
    /// Wait after the axis stands.
    pub settle_s: f64,
}

/// Third axis: what it presents at which angle.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Changer {
    /// `operator`: a person brings the sample into each place and confirms; absent = an axis of the holder.
    pub driver: Option<String>,
    /// How long an operator is waited for before the views that need them are listed as missing.
    pub confirm_within_s: Option<f64>,
    /// The axis; for an operator the angles that stand for the places.
    pub axis: Axis,
    /// Angle at which the sample's interior side faces the camera.
    pub sample_deg: f64,
    /// Angle at which the sample's exterior side faces the camera (turned about the vertical).
    pub sample_flipped_deg: f64,
    /// Angle of the reflecting diffuser.
    pub reflection_reference_deg: Option<f64>,
    /// Angle of the transmitting diffuser.
    pub transmission_reference_deg: Option<f64>,
}

/// The filter wheel.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FilterWheel {
    /// Driver name (`thorlabs-fw212c`).
    pub driver: String,
    /// Serial port path, or `sim:filter-wheel`.
    pub port: String,
    /// Number of places the wheel must report.
    pub places: u8,
    /// Time for one place, for forecasts; starting and stopping come on top.
    pub step_s: f64,
    /// Wait after arrival.
    pub settle_s: f64,
    /// What is in the places, by slot number written as a key ("1" to "12").
    pub slot: BTreeMap<String, FilterSlot>,
    /// CSV with internal transmittance at 1 mm by glass.
    pub glasses: PathBuf,
    /// CSV with the reflection factor P by glass.
    pub glass_parameters: PathBuf,
}

/// One place of the wheel.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FilterSlot {
    /// Name of the band this stack isolates, `open` or `dark`.
    pub band: String,
    /// Stated interval; absent for `open` and `dark`.
    pub interval_nm: Option<[f64; 2]>,
    /// Camera that photographs this band; absent for `open` and `dark`.
    pub camera: Option<String>,
    /// Glasses in the beam, in order; empty = no glass.
    #[serde(default)]
    pub glasses: Vec<Glass>,
}

/// One glass of a stack.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Glass {
    /// Catalogue name.
    pub glass: String,
    /// Thickness.
    pub thickness_mm: f64,
}

/// The shutter.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Shutter {
    /// Driver name (`thorlabs-sc10`).
    pub driver: String,
    /// Serial port path, or `sim:shutter`.
    pub port: String,
    /// Blade travel and settling, waited after each change.
    pub settle_s: f64,
}

/// The power meter that watches the lamp, before the shutter.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LightMonitor {
    /// Driver name (`newport-1830c`, `thorlabs-pm100`).
    pub driver: String,
    /// Serial port path, USB address, or `sim:light-monitor`.
    pub port: String,
    /// Serial number the meter must report; absent where it has none to tell.
    pub serial: Option<String>,
    /// Wavelength of the responsivity correction.
    pub wavelength_nm: f64,
    /// Readings that the meter averages into one.
    pub average: Option<u32>,
    /// Power below which the light is too weak to be the lamp.
    pub min_w: Option<f64>,
    /// Power above which something is wrong.
    pub max_w: Option<f64>,
}

/// The monochromator.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Monochromator {
    /// Driver name (`spectral-cm110`).
    pub driver: String,
    /// Serial port path, or `sim:monochromator`.
    pub port: String,
    /// Serial number it must report; absent = not checked.
    pub serial: Option<String>,
    /// Shortest wavelength that may be commanded.
    pub min_nm: f64,
    /// Longest wavelength that may be commanded.
    pub max_nm: f64,
    /// Largest accepted difference between commanded and read wavelength.
    pub tolerance_nm: f64,
    /// Wait after the grating stands.
    pub settle_s: f64,
}

/// The spectrometer.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Spectrometer {
    /// Driver name (`oceanoptics-usb`).
    pub driver: String,
    /// USB address, or `sim:spectrometer`.
    pub port: String,
    /// Serial number it must report.
    pub serial: String,
}

/// One camera.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Camera {
    /// Driver name (`v4l2`, `aravis`; `sim-ccd`, `sim-ingaas` for the simulated bench's own).
    pub driver: String,
    /// Device path or address, or `sim:ccd`.
    pub port: String,
    /// Serial number the camera must report.
    pub serial: String,
    /// Columns.
    pub width_px: usize,
    /// Rows.
    pub height_px: usize,
    /// Pixel format.
    pub format: PixelFormat,
    /// Gain, fixed.
    pub gain: f64,
    /// Shortest exposure.
    pub shortest_s: f64,
    /// Longest exposure.
    pub longest_s: f64,
    /// Read-out time of one frame.
    pub readout_s: f64,
    /// Shortest time from frame to frame.
    pub frame_interval_s: f64,
    /// Frames thrown away after a change of settings or bench.
    pub discard_frames: u32,
    /// Time to stop the stream and start it with new settings, where the camera does that when it is the shorter way.
    pub restart_s: Option<f64>,
    /// Calibration file of this camera, relative to the instrument file.
    pub calibration: PathBuf,
    /// What only the driver `v4l2` needs.
    pub v4l2: Option<V4l2Table>,
    /// What only the driver `aravis` needs.
    pub aravis: Option<AravisTable>,
}

/// Mirror and port.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Optics {
    /// Numerical eccentricity e of the hemi-ellipsoid, f/a.
    pub eccentricity: f64,
    /// Half axis a.
    pub half_axis_mm: f64,
    /// Spectral reflectance of the mirror, CSV, first value column used.
    pub mirror_reflectance: PathBuf,
    /// Half angle of the lamp's beam at the sample: the smallest peak the instrument can show.
    pub beam_half_angle_deg: f64,
    /// Standard uncertainty of emergent directions.
    pub direction_uncertainty_deg: f64,
}

/// Known diffusers.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct References {
    /// Reflecting standard.
    pub reflection: Option<Reference>,
    /// Transmitting standard.
    pub transmission: Option<Reference>,
}

/// A Lambertian standard: BSDF = value / pi.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Reference {
    /// Name and serial number for the report.
    pub name: String,
    /// Spectral hemispherical reflectance or transmittance, CSV.
    pub spectrum: PathBuf,
    /// Incidence angle at which it is photographed.
    pub theta_deg: f64,
    /// Relative standard uncertainty of its value.
    pub relative_uncertainty: f64,
}

/// The ordered list that makes the bench safe; all are tried even if one fails.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SafeState {
    /// Device names in order: `shutter`, `tilt`, `spin`, `changer`, `filter_wheel`, `cameras`.
    pub order: Vec<String>,
    /// Limit for each.
    pub limit_s: f64,
}

/// The wire of one device or chain, as the instrument file names it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Link<'a> {
    /// Its table in the file: `holder`, `light_monitor`, `camera.ccd`, ….
    pub key: String,
    /// Driver name.
    pub driver: &'a str,
    /// Path or address, or `sim:…`.
    pub port: &'a str,
}

// === impl Lamp ===

impl Lamp {
    /// Characters that a serial number may have at most: it names a file.
    pub const SERIAL_CHARS: usize = 64;

    /// True for letters, digits, `-`, `_` and `.`, beginning with a letter or digit.
    pub fn is_serial(serial: &str) -> bool {
        let plain = |c: char| c.is_ascii_alphanumeric() || matches!(c, '-' | '_' | '.');
        let begins = serial.starts_with(|c: char| c.is_ascii_alphanumeric());
        begins && serial.len() <= Lamp::SERIAL_CHARS && serial.chars().all(plain)
    }
}

// === impl Instrument ===

impl Instrument {
    /// Every wire of the instrument, in the order a run opens them: what is closed first comes first.
    pub fn links(&self) -> Vec<Link<'_>> {
        let link = |key: &str, driver, port| Link { key: key.to_owned(), driver, port };
        let mut all = vec![
            link("shutter", &*self.shutter.driver, &*self.shutter.port),
            link("filter_wheel", &self.filter_wheel.driver, &self.filter_wheel.port),
            link("holder", &self.holder.driver, &self.holder.port),
        ];
        all.extend(self.light_monitor.iter().map(|d| link("light_monitor", &d.driver, &d.port)));
        all.extend(self.monochromator.iter().map(|d| link("monochromator", &d.driver, &d.port)));
        all.extend(self.spectrometer.iter().map(|d| link("spectrometer", &d.driver, &d.port)));
        all.extend(self.camera.iter().map(|(name, d)| link(&format!("camera.{name}"), &d.driver, &d.port)));
        all
    }
}

// === impl Link ===

impl Link<'_> {
    /// The camera's name, where it is one's wire.
    pub fn camera(&self) -> Option<&str> {
        self.key.strip_prefix("camera.")
    }

    /// True when a twin of the simulated bench answers there.
    pub fn is_simulated(&self) -> bool {
        self.port.starts_with("sim:")
    }
}

// === impl Changer ===

impl Changer {
    /// Driver name of a person as changer.
    pub const OPERATOR: &'static str = "operator";
    /// How long an operator is waited for where the file does not say.
    const CONFIRM_WITHIN_S: f64 = 3600.0;

    /// How long a person who is the changer is waited for; `None` where it is an axis.
    pub fn operator_within(&self) -> Option<Duration> {
        let is_operator = self.driver.as_deref() == Some(Self::OPERATOR);
        is_operator.then(|| seconds(self.confirm_within_s.unwrap_or(Self::CONFIRM_WITHIN_S)))
    }
}

// === impl Camera ===

impl Camera {
    /// Format that holds every frame of this camera: that of the longest sum where exposures are summed.
    pub fn stored_format(&self) -> PixelFormat {
        match self.v4l2.as_ref().and_then(|table| table.sum_frames) {
            Some(exposures) if exposures > 1 => {
                PixelFormat::Summed { mosaic: self.format.mosaic(), bits: self.format.bits(), exposures }
            }
            _ => self.format,
        }
    }

    /// Frames that are summed for an exposure of `total_s`; 1 where the camera does not sum.
    pub fn frames_in(&self, total_s: f64) -> u16 {
        let sums = self.v4l2.as_ref().filter(|table| table.sum_frames.is_some_and(|most| most > 1));
        sums.map_or(1, |table| V4l2Table::frames_in(total_s, table.longest_frame_s.unwrap_or(self.longest_s)) as u16)
    }
}
