//! Cameras of a run as the engine sees them: level table, pixel maps for both faces of the sample.

use super::inputs::Run;
use crate::config::calibration::{self, CameraCalibration};
use crate::config::instrument::Camera;
use crate::config::scan::BasisName;
use crate::engine::optics::basis::AngleBasis;
use crate::engine::optics::ellipsoid::Ellipsoid;
use crate::engine::optics::fisheye::Fisheye;
use crate::engine::optics::pixel_map::{Mosaic, PixelMap, PixelMapSpec};
use crate::engine::radiometry::levels::{LevelTable, Noise, Radiometer};
use crate::engine::radiometry::response::{LevelConvention, Response};
use crate::products::error::{ProductError, Result, engine};
use goniod_drivers::frame::{BayerOrder, PixelFormat};
use std::collections::BTreeMap;

/// One camera ready to read brackets.
pub struct CameraOptics {
    /// Level -> exposure.
    pub table: LevelTable,
    /// Pixels -> patches, interior side towards the camera.
    pub straight: PixelMap,
    /// Pixels -> patches, exterior side towards the camera.
    pub flipped: PixelMap,
    /// Pixels at the beginning of a frame that are no picture.
    pub reserved: usize,
}

/// The emergent basis of a scan: that of its incidence, else Klems Full.
pub fn basis(run: &Run) -> AngleBasis {
    run.document.scan.incidence.basis.map_or_else(AngleBasis::klems_full, BasisName::basis)
}

/// Every camera that the plan uses.
pub fn cameras(run: &Run) -> Result<BTreeMap<String, CameraOptics>> {
    let used = run.document.plan.arrays.iter().map(|a| a.camera.clone());
    used.map(|name| {
        let camera = run.document.instrument.camera.get(&name);
        let calibration = run.document.calibrations.get(&name);
        let (Some(camera), Some(calibration)) = (camera, calibration) else {
            return Err(ProductError::Nothing(format!(
                "the run's plan uses camera `{name}`, which its instrument does not describe"
            )));
        };
        let optics = camera_optics(run, &name, camera, calibration)?;
        Ok((name, optics))
    })
    .collect()
}

fn camera_optics(run: &Run, name: &str, camera: &Camera, calibration: &CameraCalibration) -> Result<CameraOptics> {
    let what = || format!("camera `{name}`");
    let table = LevelTable::of(radiometer(camera, calibration)).map_err(engine(what()))?;
    let geometry = &calibration.geometry;
    let optics = &run.document.instrument.optics;
    let spec = |flipped| -> Result<PixelMapSpec> {
        Ok(PixelMapSpec {
            width: camera.width_px,
            height: camera.height_px,
            reserved_rows: geometry.reserved_rows,
            mosaic: mosaic(camera.format),
            fisheye: Fisheye {
                centre_x_px: geometry.centre_x_px,
                centre_y_px: geometry.centre_y_px,
                deg_per_px: geometry.deg_per_px,
                roll_deg: geometry.roll_deg,
            },
            ellipsoid: Ellipsoid::new(optics.eccentricity).map_err(engine("the mirror"))?,
            basis: basis(run),
            flipped,
            direction_u_deg: optics.direction_uncertainty_deg,
            blur_px: geometry.blur_px,
            vignetting: calibration.vignetting.even_coefficients.clone(),
        })
    };
    let map = |flipped| PixelMap::build(&spec(flipped)?).map_err(engine(what()));
    let reserved = geometry.reserved_rows * camera.width_px;
    Ok(CameraOptics { table, straight: map(false)?, flipped: map(true)?, reserved })
}

/// The mosaic of a format; pixels that hold several values come colour by colour.
fn mosaic(format: PixelFormat) -> Mosaic {
    match format.mosaic() {
        Some(BayerOrder::Rggb) => Mosaic::BayerRggb,
        Some(BayerOrder::Grbg) => Mosaic::BayerGrbg,
        Some(BayerOrder::Gbrg) => Mosaic::BayerGbrg,
        Some(BayerOrder::Bggr) => Mosaic::BayerBggr,
        None => Mosaic::Mono,
    }
}

/// The calibration file's radiometry in the engine's words.
pub fn radiometer(camera: &Camera, calibration: &CameraCalibration) -> Radiometer {
    let r = &calibration.response;
    let response = match r.form {
        calibration::ResponseForm::Linear => Response::Linear,
        calibration::ResponseForm::LogisticDoseResponse => {
            // In either convention the file's constants and responsivities belong together: as printed, r = 1/h*.
            match (r.a, r.b, r.c, r.d) {
                (Some(a), Some(b), Some(c), Some(d)) => Response::LogisticDoseResponse { a, b, c, d },
                _ => Response::paper(),
            }
        }
    };
    Radiometer {
        response,
        convention: match r.level_convention {
            calibration::LevelConvention::BinEdge => LevelConvention::BinEdge,
            calibration::LevelConvention::BinCentre => LevelConvention::BinCentre,
        },
        levels: camera.format.levels(),
        noise: Noise {
            electrons_at_unit_exposure: calibration.noise.electrons_at_unit_exposure,
            read_noise_e: calibration.noise.read_noise_e,
        },
        residual_ndl: r.residual_ndl,
    }
}
