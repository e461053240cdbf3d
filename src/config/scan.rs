//! `scan.toml`: what to measure.

use crate::engine::optics::side::Side;
use serde::{Deserialize, Serialize};

/// What to measure, as the file says it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Scan {
    /// Name of the scan; goes into the run's name and the report.
    pub name: String,
    /// What lies in the holder.
    pub sample: Sample,
    /// Incident directions and sides.
    pub incidence: Incidence,
    /// Which bands.
    pub bands: Bands,
    /// Integration times.
    pub exposure: Exposure,
    /// Rhythm of darks.
    #[serde(default)]
    pub dark: Dark,
    /// Rhythm of reference views.
    #[serde(default)]
    pub reference: ReferenceRhythm,
    /// What to make of it.
    #[serde(default)]
    pub products: Products,
}

/// Header data of the sample.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Sample {
    /// Name in the exported files; the scan's name when absent.
    pub name: Option<String>,
    /// Who makes it.
    pub manufacturer: Option<String>,
    /// Thickness.
    pub thickness_mm: f64,
    /// Device type of the Klems file; `Other` when absent.
    pub device_type: Option<String>,
    /// Rotational symmetry that may be used to fill what was not measured.
    #[serde(default)]
    pub symmetry: Symmetry,
    /// Only for a simulated bench: the sample that lies in it (a file of `config/sim/samples/`), relative to the scan file.
    pub simulated: Option<std::path::PathBuf>,
}

/// Rotational symmetry of the sample.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Symmetry {
    /// No azimuth measured: the same for every azimuth.
    Isotropic,
    /// Nothing is assumed.
    #[default]
    None,
}

/// Incident directions: exactly one of `basis`, `directions`, `grid`, `ring`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Incidence {
    /// `klems-full`, `klems-half` or `klems-quarter`: the centres of all patches.
    pub basis: Option<BasisName>,
    /// Explicit list of [theta_deg, phi_deg] of the vector to the source.
    pub directions: Option<Vec<[f64; 2]>>,
    /// Product of two lists.
    pub grid: Option<Grid>,
    /// All azimuths of one ring of Klems Full, by its nominal theta, or an even ring.
    pub ring: Option<Ring>,
    /// Which hemispheres are measured.
    pub sides: Vec<Side>,
}

/// Names of the angle bases.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum BasisName {
    /// 145 patches.
    KlemsFull,
    /// 77 patches (LBNL).
    KlemsHalf,
    /// 41 patches (LBNL).
    KlemsQuarter,
}

/// A grid of incident directions.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Grid {
    /// Polar angles.
    pub theta_deg: Vec<f64>,
    /// Azimuths.
    pub phi_deg: Vec<f64>,
}

/// One ring: `count` azimuths at one polar angle, the first at `start_phi_deg`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Ring {
    /// Polar angle.
    pub theta_deg: f64,
    /// Number of azimuths, evenly spaced.
    pub count: u32,
    /// First azimuth.
    #[serde(default)]
    pub start_phi_deg: f64,
}

/// Which bands.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Bands {
    /// Names of bands of the instrument's wheel, in any order.
    #[serde(rename = "use")]
    pub names: Vec<String>,
}

/// Integration times.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Exposure {
    /// How the times are chosen.
    pub policy: ExposurePolicy,
    /// Ratio of neighbouring times.
    pub ratio: f64,
    /// Shortest time.
    pub shortest_s: f64,
    /// Longest time.
    pub longest_s: f64,
}

/// How the integration times are chosen.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ExposurePolicy {
    /// A fixed ladder: longest, longest/ratio, … down to the shortest.
    Ladder,
}

/// Rhythm of dark frames: at the start and after so many directions; frames for each exposure time.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Dark {
    /// A set of darks after every so many directions (each side counts); 0 = only at the start.
    #[serde(default)]
    pub every_directions: u32,
    /// Frames a set takes of each exposure time.
    #[serde(default = "Dark::default_frames")]
    pub frames: u32,
}

/// Rhythm of reference views.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ReferenceRhythm {
    /// Reference views at the start, after every so many directions (each side counts) and at the end; 0 = only at
    /// the start and at the end.
    #[serde(default)]
    pub every_directions: u32,
    /// How the BSDF is normalised.
    #[serde(default)]
    pub mode: ReferenceMode,
}

/// The denominator of eq. (1).
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ReferenceMode {
    /// Views of a known diffuser.
    #[default]
    Diffuser,
    /// The lamp's irradiance from the instrument file and absolute camera calibration.
    Irradiance,
}

/// What to make of the run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Products {
    /// Files to write.
    pub formats: Vec<Format>,
}

/// A product file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Format {
    /// WINDOW / Radiance Klems matrix XML.
    KlemsXml,
    /// HDF5 with NeXus layout.
    Hdf5,
}

// === impl Dark ===

impl Dark {
    fn default_frames() -> u32 {
        4
    }
}

impl Default for Dark {
    fn default() -> Dark {
        Dark { every_directions: 0, frames: Dark::default_frames() }
    }
}

// === impl Products ===

impl Default for Products {
    fn default() -> Products {
        Products { formats: vec![Format::KlemsXml, Format::Hdf5] }
    }
}
