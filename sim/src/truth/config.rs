//! `bench.toml`: what the simulated bench is, as built to plan. Values may differ from an instrument file's
//! calibration by what `[deviation]` allows.

use super::error::{Result, SimError, read_text};
use super::spectrum::SpectrumFile;
use goniod_drivers::frame::PixelFormat;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// The whole bench.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BenchFile {
    /// Name for logs.
    pub name: String,
    /// No noise, no dark signal, no drift, no deviation.
    pub ideal: bool,
    /// The light source.
    pub lamp: LampFile,
    /// Filter wheel.
    pub wheel: WheelFile,
    /// Hemi-ellipsoid.
    pub mirror: MirrorFile,
    /// What the holder presents at which angle.
    pub holder: HolderFile,
    /// Diffusers.
    pub reference: ReferenceFile,
    /// Cameras by name.
    pub camera: BTreeMap<String, CameraFile>,
    /// Standard deviations of what the seed draws.
    pub deviation: DeviationFile,
}

/// The light source.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LampFile {
    /// Relative spectral power.
    pub spectrum: SpectrumFile,
    /// Irradiance of the sample at normal incidence without filter, 300-1700 nm, uW/cm2.
    pub irradiance_uw_per_cm2: f64,
    /// Half angle of the beam's disc.
    pub beam_half_angle_deg: f64,
    /// Steepest slope of the slow sine, relative per hour.
    pub drift_per_hour: f64,
    /// Period of the slow sine.
    pub drift_period_h: f64,
    /// Random walk, relative standard deviation after one hour.
    pub walk_per_sqrt_hour: f64,
    /// Relative standard deviation from exposure to exposure.
    pub flicker: f64,
    /// Struck when the bench is opened (true), or long before.
    #[serde(default)]
    pub cold_start: bool,
    /// Time constant of the warm-up after ignition.
    #[serde(default = "warm_up_time_constant_s")]
    pub warm_up_time_constant_s: f64,
    /// Output at ignition, relative to the steady one.
    #[serde(default = "cold_output")]
    pub cold_output: f64,
    /// Cooling that the arc needs before it can be struck again.
    #[serde(default = "restrike_s")]
    pub restrike_s: f64,
    /// Power that the steady lamp puts on the light monitor's photodiode.
    #[serde(default = "monitor_power_w")]
    pub monitor_power_w: f64,
}

fn warm_up_time_constant_s() -> f64 {
    60.0
}

fn cold_output() -> f64 {
    0.3
}

fn restrike_s() -> f64 {
    600.0
}

fn monitor_power_w() -> f64 {
    1.0e-3
}

/// Filter wheel.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WheelFile {
    /// CSV of internal transmittances at 1 mm.
    pub glasses: PathBuf,
    /// CSV of reflection factors P.
    pub glass_parameters: PathBuf,
    /// Places by number ("1" …).
    pub slot: BTreeMap<String, SlotFile>,
}

/// One place of the wheel.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SlotFile {
    /// Name of the band.
    pub band: String,
    /// A blank: no light passes.
    #[serde(default)]
    pub blank: bool,
    /// Glasses in the beam.
    #[serde(default)]
    pub glasses: Vec<GlassFile>,
}

/// One glass.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GlassFile {
    /// Catalogue name.
    pub glass: String,
    /// Thickness.
    pub thickness_mm: f64,
}

/// Hemi-ellipsoid.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ShapeFile {
    /// Half axis a.
    pub half_axis_mm: f64,
    /// Numerical eccentricity e = f/a.
    pub eccentricity: f64,
}

/// Mirror: shape and reflectance.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MirrorFile {
    /// Shape.
    pub shape: ShapeFile,
    /// Spectral reflectance.
    pub reflectance: SpectrumFile,
}

/// What the holder presents.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HolderFile {
    /// Tilt axis angle at T = 0.
    pub tilt_zero_deg: f64,
    /// Spin axis angle at P = 0.
    pub spin_zero_deg: f64,
    /// Changer angle that shows the sample's interior side.
    pub sample_deg: f64,
    /// Changer angle that shows its exterior side.
    pub sample_flipped_deg: f64,
    /// Changer angle of the reflecting diffuser.
    pub reflection_reference_deg: f64,
    /// Changer angle of the transmitting diffuser.
    pub transmission_reference_deg: f64,
    /// Within this distance of such an angle the object stands before the camera, else nothing does.
    pub tolerance_deg: f64,
    /// Radius of the free area of sample and diffusers.
    pub sample_radius_mm: f64,
}

/// Diffusers: BSDF = value / pi.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ReferenceFile {
    /// Reflecting.
    pub reflection: SpectrumFile,
    /// Transmitting.
    pub transmission: SpectrumFile,
}

/// One camera.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CameraFile {
    /// Model it reports.
    pub model: String,
    /// Serial number it reports.
    pub serial: String,
    /// Columns.
    pub width_px: usize,
    /// Rows.
    pub height_px: usize,
    /// Format of its frames.
    pub format: PixelFormat,
    /// Fisheye.
    pub fisheye: FisheyeFile,
    /// CSV of responsivities, relative exposure per uJ/(cm2 sr).
    pub responsivity: PathBuf,
    /// Columns of that CSV, one a channel (R, G, B for a mosaic).
    pub channels: Vec<String>,
    /// Response NDL = f(x).
    pub response: ResponseFile,
    /// Electrons at x = 1.
    pub electrons_at_unit_exposure: f64,
    /// Read noise, electrons.
    pub read_noise_e: f64,
    /// Dark signal, x per second.
    pub dark_per_s: f64,
    /// Clock and registers.
    pub timing: TimingFile,
}

/// Fisheye lens and where its axis meets the sensor.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FisheyeFile {
    /// Column of the principal point; pixel centres at whole numbers.
    pub centre_x_px: f64,
    /// Row of the principal point.
    pub centre_y_px: f64,
    /// Zenith angle per pixel.
    pub deg_per_px: f64,
    /// Azimuth of v = azimuth in the image + roll.
    pub roll_deg: f64,
    /// Rows from the top that carry painted truth instead of a picture.
    pub reserved_rows: usize,
    /// VC = 1 + c2 t^2 + c4 t^4 + …, t = theta / 90 degrees.
    pub vignetting: Vec<f64>,
    /// Diameter of the entrance pupil.
    pub pupil_diameter_mm: f64,
    /// Walk of the pupil along the axis: w2 t^2 + w4 t^4 + …, mm.
    pub pupil_walk_mm: Vec<f64>,
    /// Standard deviation of the point spread of lens and low-pass filter, pixels.
    pub blur_px: f64,
}

/// Response of the sensor.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(tag = "form", rename_all = "kebab-case", deny_unknown_fields)]
pub enum ResponseFile {
    /// Eq. (4): NDL = a + b / (1 + (x/c)^d), c so that f(1) = 0.3.
    Logistic {
        /// Lower asymptote.
        a: f64,
        /// Height.
        b: f64,
        /// Scale c'.
        c: f64,
        /// Exponent.
        d: f64,
    },
    /// NDL = slope x.
    Linear {
        /// NDL at x = 1.
        slope: f64,
    },
}

/// Sensor clock and register pipeline.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TimingFile {
    /// Shortest exposure.
    pub shortest_s: f64,
    /// Longest exposure.
    pub longest_s: f64,
    /// Gain, the only value accepted.
    pub gain: f64,
    /// Read-out and transfer of a frame.
    pub readout_s: f64,
    /// Shortest time from frame start to frame start.
    pub frame_interval_s: f64,
    /// Frames that start after a setting was written and still carry the old one.
    pub latency_frames: u32,
    /// Time to stop and start the stream, after which new settings hold at once; absent = the stream cannot be
    /// restarted, every change waits for the pipeline.
    pub restart_s: Option<f64>,
}

/// Standard deviations of how the bench as built differs from its description.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DeviationFile {
    /// Value of each diffuser, relative.
    pub reference_scale: f64,
    /// Response curve, NDL.
    pub response_ndl: f64,
    /// Vignetting field, relative.
    pub vignetting: f64,
    /// Pointing of each camera about two axes.
    pub pointing_deg: f64,
    /// Responsivity of each camera, relative.
    pub responsivity_scale: f64,
}

// === impl BenchFile ===

impl BenchFile {
    /// Reads and checks a bench file.
    pub fn read(path: &Path) -> Result<BenchFile> {
        let text = read_text(path)?;
        let mut bench: BenchFile = toml::from_str(&text).map_err(|e| SimError::format(path, e.to_string()))?;
        bench.check(path)?;
        if bench.ideal {
            bench.idealise();
        }
        Ok(bench)
    }

    fn check(&self, path: &Path) -> Result<()> {
        within(path, "mirror.shape.eccentricity", self.mirror.shape.eccentricity, 0.0, 0.8)?;
        within(path, "mirror.shape.half_axis_mm", self.mirror.shape.half_axis_mm, 50.0, 5000.0)?;
        within(path, "lamp.beam_half_angle_deg", self.lamp.beam_half_angle_deg, 0.05, 2.0)?;
        within(path, "lamp.irradiance_uw_per_cm2", self.lamp.irradiance_uw_per_cm2, 1e-6, 1e9)?;
        within(path, "lamp.drift_period_h", self.lamp.drift_period_h, 0.1, 1000.0)?;
        within(path, "lamp.warm_up_time_constant_s", self.lamp.warm_up_time_constant_s, 0.1, 3600.0)?;
        within(path, "lamp.cold_output", self.lamp.cold_output, 0.0, 1.0)?;
        within(path, "lamp.restrike_s", self.lamp.restrike_s, 0.0, 7200.0)?;
        within(path, "lamp.monitor_power_w", self.lamp.monitor_power_w, 1e-9, 1.0)?;
        within(path, "holder.sample_radius_mm", self.holder.sample_radius_mm, 1.0, 1000.0)?;
        if self.wheel.slot.is_empty() {
            return Err(SimError::format(path, "wheel.slot has no place; name at least one"));
        }
        for key in self.wheel.slot.keys() {
            if key.parse::<u8>().map_or(true, |n| n == 0) {
                let message = format!("wheel.slot.{key}: places are named by their number, \"1\" to \"255\"");
                return Err(SimError::format(path, message));
            }
        }
        self.camera.iter().try_for_each(|(name, camera)| camera.check(path, name))
    }

    /// Takes out everything random, every dark signal and the quantisation.
    pub fn idealise(&mut self) {
        self.ideal = true;
        self.lamp.drift_per_hour = 0.0;
        self.lamp.walk_per_sqrt_hour = 0.0;
        self.lamp.flicker = 0.0;
        self.deviation = DeviationFile {
            reference_scale: 0.0,
            response_ndl: 0.0,
            vignetting: 0.0,
            pointing_deg: 0.0,
            responsivity_scale: 0.0,
        };
        for camera in self.camera.values_mut() {
            camera.dark_per_s = 0.0;
            camera.read_noise_e = 0.0;
        }
    }
}

// === impl CameraFile ===

impl CameraFile {
    fn check(&self, path: &Path, name: &str) -> Result<()> {
        let key = |what: &str| format!("camera.{name}.{what}");
        within(path, &key("width_px"), self.width_px as f64, 64.0, 8192.0)?;
        within(path, &key("height_px"), self.height_px as f64, 64.0, 8192.0)?;
        within(path, &key("fisheye.deg_per_px"), self.fisheye.deg_per_px, 0.01, 5.0)?;
        within(path, &key("fisheye.reserved_rows"), self.fisheye.reserved_rows as f64, 0.0, self.height_px as f64)?;
        within(path, &key("electrons_at_unit_exposure"), self.electrons_at_unit_exposure, 1.0, 1e9)?;
        within(path, &key("timing.shortest_s"), self.timing.shortest_s, 1e-6, 1.0)?;
        within(path, &key("timing.longest_s"), self.timing.longest_s, self.timing.shortest_s, 3600.0)?;
        within(path, &key("timing.readout_s"), self.timing.readout_s, 0.0, 10.0)?;
        within(path, &key("timing.frame_interval_s"), self.timing.frame_interval_s, 1e-4, 10.0)?;
        let wanted = if self.format == PixelFormat::BayerRggb8 { 3 } else { 1 };
        if self.channels.len() != wanted {
            let message = format!("{}: this format has {wanted} channel(s), name that many columns", key("channels"));
            return Err(SimError::format(path, message));
        }
        Ok(())
    }

    /// Number of levels of its frames.
    pub fn levels(&self) -> u32 {
        self.format.levels()
    }
}

/// `value` must lie in the range (NaN never does).
fn within(path: &Path, key: &str, value: f64, low: f64, high: f64) -> Result<()> {
    if (low..=high).contains(&value) {
        return Ok(());
    }
    Err(SimError::format(path, format!("{key} = {value} is out of range; {low} to {high} is allowed")))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used)]
    use super::*;
    use crate::test_bench;

    fn read(change: impl Fn(String) -> String) -> Result<BenchFile> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("bench.toml");
        std::fs::write(&path, change(std::fs::read_to_string(test_bench::path("bench.toml")).unwrap())).unwrap();
        BenchFile::read(&path)
    }

    #[test]
    fn wrong_keys_and_values_are_named() {
        assert!(read(|t| t).is_ok());
        let unknown = read(|t| t.replace("tolerance_deg", "tolerance_grad")).unwrap_err().to_string();
        assert!(unknown.contains("tolerance_grad") && unknown.contains("bench.toml"), "{unknown}");
        let flat = read(|t| t.replace("eccentricity = 0.3", "eccentricity = 1.3")).unwrap_err().to_string();
        assert!(flat.contains("mirror.shape.eccentricity = 1.3 is out of range; 0 to 0.8"), "{flat}");
        let slot = read(|t| t.replace("[wheel.slot.12]", "[wheel.slot.last]")).unwrap_err().to_string();
        assert!(slot.contains("wheel.slot.last"), "{slot}");
    }
}
