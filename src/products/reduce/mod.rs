//! Run -> BSDF: raw frames of a run directory become radiance rates, readings, band values and totals.
//!
//! - [`inputs`]: what the run kept becomes the engine's values
//! - [`optics`]: cameras, lenses and level tables; [`readings`]: spectral kernels of every band and channel
//! - [`cover`]: do the tables reach as far as the bands see
//! - [`planes`]: frames of several values a pixel; [`views`]: brackets of frames -> patch means
//! - [`light`]: the lamp's level through the night; [`columns`]: sample over reference, bands into totals

mod columns;
mod cover;
mod inputs;
mod light;
mod optics;
mod planes;
mod readings;
mod views;

pub use cover::quantities;
pub use inputs::{InstrumentSpectra, Run, Standards};
pub use optics::radiometer;
pub use readings::Setup;

use super::error::Result;
use crate::engine::bsdf::set::BsdfSet;
use serde::Serialize;

/// Result of a reduction.
#[derive(Debug, Clone)]
pub struct Reduction {
    /// The BSDF with uncertainty.
    pub set: BsdfSet,
    /// What a reader of the report should know.
    pub facts: Facts,
}

/// What happened on the way, for the report.
#[derive(Debug, Clone, Default, Serialize)]
pub struct Facts {
    /// Sample brackets that have frames.
    pub views_reduced: usize,
    /// Sample brackets without any frame.
    pub views_missing: usize,
    /// Largest change of a reference from one view to the next, relative.
    pub largest_reference_change: Option<f64>,
    /// Largest part of a headline hemispherical value that light below the floor may be, relative (k = 2).
    pub floor_relative: f64,
    /// Largest saturated share of a patch.
    pub largest_saturated: f64,
    /// Dark rate by camera, relative exposure per second: median, hot pixels masked.
    pub darks: Vec<DarkFacts>,
    /// Root mean square of each part of the uncertainty over the patches of the headline quantity, relative to their mean.
    pub budget: Vec<(String, f64)>,
    /// Remarks for the report.
    pub notes: Vec<String>,
}

/// Dark signal of one camera.
#[derive(Debug, Clone, Serialize)]
pub struct DarkFacts {
    /// Camera.
    pub camera: String,
    /// Standard uncertainty of a pixel's dark rate, relative exposure per second.
    pub u_rate: f64,
    /// Standard uncertainty that all pixels share, relative exposure per second.
    pub u_common: f64,
    /// Pixels masked as hot.
    pub hot_pixels: usize,
    /// Pixels too dark to be read one by one.
    pub unreadable_pixels: usize,
}

/// Reduces a run: deterministic for equal inputs, on any number of threads.
///
/// # Errors
/// [`super::error::ProductError`]: a damaged or foreign run, inputs that the engine refuses, a run without frames.
pub fn reduce(run: &Run) -> Result<Reduction> {
    let cameras = optics::cameras(run)?;
    let readings = readings::readings(run.setup())?;
    let views = views::reduce_views(run, &cameras)?;
    columns::columns(run, &readings, &views)
}
