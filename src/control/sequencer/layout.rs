//! The run directory's shape for a plan. Pure.

use crate::archive::{ArrayLayout, RunLayout, StepLayout};
use crate::config::instrument::Camera;
use crate::control::plan::{Plan, View};
use std::collections::BTreeMap;
use thiserror::Error;

/// A plan that contradicts itself or the instrument.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum LayoutError {
    /// The plan names a camera that the instrument file has not.
    #[error("the plan uses camera \"{0}\"; the instrument file has no [camera.{0}]: make the plan again")]
    NoCamera(String),
    /// A step names a view that the plan has not.
    #[error("step {step} belongs to view {view}, which the plan has not: make the plan again")]
    NoView {
        /// Step.
        step: u32,
        /// View.
        view: u32,
    },
}

/// Arrays and steps of a plan, with the frame sizes of the instrument's cameras.
///
/// # Errors
/// [`LayoutError`].
pub fn layout(plan: &Plan, cameras: &BTreeMap<String, Camera>) -> Result<RunLayout, LayoutError> {
    let mut arrays = Vec::with_capacity(plan.arrays.len());
    for array in &plan.arrays {
        let camera = cameras.get(&array.camera).ok_or_else(|| LayoutError::NoCamera(array.camera.clone()))?;
        arrays.push(ArrayLayout {
            camera: array.camera.clone(),
            views: array.views,
            exposures: array.exposures,
            rows: camera.height_px,
            columns: camera.width_px * camera.format.values_per_pixel(),
            format: camera.stored_format(),
        });
    }
    let views: BTreeMap<u32, &View> = plan.views.iter().map(|view| (view.id, view)).collect();
    let mut steps = Vec::with_capacity(plan.steps.len());
    for step in &plan.steps {
        let view = views.get(&step.view).ok_or(LayoutError::NoView { step: step.number, view: step.view })?;
        steps.push(StepLayout {
            number: step.number,
            view: step.view,
            camera: view.camera.clone(),
            array_index: view.array_index,
            exposure_index: step.exposure_index,
            exposure_us: step.exposure.0,
        });
    }
    Ok(RunLayout { plan_hash: plan.hash.clone(), arrays, steps })
}
