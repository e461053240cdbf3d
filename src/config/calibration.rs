//! Camera calibration files: response, responsivity, noise, geometry, vignetting, with date and validity.

use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// Calibration of one camera.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CameraCalibration {
    /// Serial number of the camera it belongs to.
    pub camera_serial: String,
    /// Day it was made.
    pub date: jiff::civil::Date,
    /// Last day it may be used.
    pub valid_until: jiff::civil::Date,
    /// Response NDL = f(x), eq. (4).
    pub response: Response,
    /// Absolute spectral responsivity r(lambda) = 1/h.
    pub responsivity: Responsivity,
    /// Photon-transfer numbers.
    pub noise: Noise,
    /// Pixels to directions.
    pub geometry: Geometry,
    /// Light drop-off towards the edge, VC(x, y).
    pub vignetting: Vignetting,
}

/// Logistic dose response of eq. (4), or a straight line.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Response {
    /// Functional form.
    pub form: ResponseForm,
    /// Asymptote a (logistic).
    pub a: Option<f64>,
    /// Height b (logistic).
    pub b: Option<f64>,
    /// Scale c (logistic).
    pub c: Option<f64>,
    /// Exponent d (logistic).
    pub d: Option<f64>,
    /// What an exposure of one means: `f-of-1-is-0.3` (c is c', h is h0.3) or `as-printed` (c of the paper, h is h*).
    pub convention: ResponseConvention,
    /// Which level a reading stands for: lower edge of the bin DL/2^bits, or its centre (DL+0.5)/2^bits.
    pub level_convention: LevelConvention,
    /// Standard uncertainty of the curve in NDL.
    pub residual_ndl: f64,
}

/// Functional form of the response.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ResponseForm {
    /// NDL = a + b / (1 + (x/c)^d).
    LogisticDoseResponse,
    /// NDL = 0.3 x.
    Linear,
}

/// Normalisation of the exposure scale (physics: c' against c).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum ResponseConvention {
    /// f(1) = 0.3 exactly; responsivities are 1/h0.3.
    #[serde(rename = "f-of-1-is-0.3")]
    FOfOneIs03,
    /// Constants as printed; responsivities are 1/h*, h* = h0.3 / g(0.3).
    #[serde(rename = "as-printed")]
    AsPrinted,
}

/// Which level a digital number stands for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum LevelConvention {
    /// DL / 2^bits.
    BinEdge,
    /// (DL + 0.5) / 2^bits.
    BinCentre,
}

/// Spectral responsivity.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Responsivity {
    /// CSV `wavelength_nm,r,g,b` or `wavelength_nm,value`; relative exposure per uJ/(cm2 sr).
    pub file: PathBuf,
    /// Relative standard uncertainty of the absolute scale.
    pub scale_relative_uncertainty: f64,
    /// Relative standard uncertainty of the shape.
    pub shape_relative_uncertainty: f64,
}

/// Noise model in electrons.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Noise {
    /// Electrons at relative exposure x = 1.
    pub electrons_at_unit_exposure: f64,
    /// Read noise.
    pub read_noise_e: f64,
}

/// Equidistant fisheye.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Geometry {
    /// Column of the principal point, pixel centres at whole numbers.
    pub centre_x_px: f64,
    /// Row of the principal point.
    pub centre_y_px: f64,
    /// Zenith angle per pixel.
    pub deg_per_px: f64,
    /// Rotation of the camera about its axis.
    pub roll_deg: f64,
    /// Rows from the top that carry no picture.
    pub reserved_rows: usize,
    /// Standard deviation of the point spread of lens and low-pass filter; 0 = not known to spread.
    pub blur_px: f64,
}

/// VC as an even polynomial of the zenith angle: signal = scene * (1 + c2 t^2 + c4 t^4 + …), t = theta / 90 degrees.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Vignetting {
    /// Coefficients c2, c4, ….
    pub even_coefficients: Vec<f64>,
    /// Relative standard uncertainty.
    pub relative_uncertainty: f64,
}
