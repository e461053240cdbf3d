//! Brackets of frames -> patch means, view by view. Views are independent and reduced side by side.

use super::inputs::Run;
use super::optics::CameraOptics;
use crate::control::plan::{Step, Subject, View};
use crate::engine::bsdf::patches::ViewPatches;
use crate::engine::optics::pixel_map::PixelMap;
use crate::engine::radiometry::dark::Dark;
use crate::engine::radiometry::merge::{Exposure, merge};
use crate::products::error::{ProductError, Result, engine};
use goniod_drivers::frame::Pixels;
use rayon::prelude::*;
use std::collections::BTreeMap;

/// A reduced bracket.
#[derive(Debug, Clone)]
pub struct ReducedView {
    /// The plan's view.
    pub view: View,
    /// Start of its first frame, UTC microseconds; `None` without frames.
    pub utc_us: Option<i64>,
    /// Patch means, scaled to the lamp's first level where there is a light monitor; `None` without frames.
    pub patches: Option<ViewPatches>,
    /// Relative standard uncertainty of that scaling; `None` without light monitor.
    pub drift_relative_u: Option<f64>,
}

/// All views of a run.
pub struct ReducedViews {
    /// In the order of the plan, darks left out.
    pub views: Vec<ReducedView>,
    /// Dark rate of each camera.
    pub darks: BTreeMap<String, Dark>,
}

/// Reduces every reference and sample view.
pub fn reduce_views(run: &Run, cameras: &BTreeMap<String, CameraOptics>) -> Result<ReducedViews> {
    let brackets = brackets(run);
    let mut darks = BTreeMap::new();
    for (name, optics) in cameras {
        darks.insert(name.clone(), dark_of(run, name, optics, &brackets)?);
    }
    let wanted: Vec<&View> = run.document.plan.views.iter().filter(|v| v.subject != Subject::Dark).collect();
    let views = wanted
        .par_iter()
        .map(|view| {
            let lost = || ProductError::Nothing(format!("the plan uses camera `{}`, which the run lacks", view.camera));
            let optics = cameras.get(&view.camera).ok_or_else(lost)?;
            let dark = darks.get(&view.camera).ok_or_else(lost)?;
            let frames = frames_of(run, view, brackets.get(&view.id).map_or(&[][..], Vec::as_slice))?;
            let patches = if frames.is_empty() { None } else { Some(merge_view(view, optics, dark, &frames)?) };
            let drift = run.drift_factor(view.id);
            let patches = patches.map(|p| drift.map_or_else(|| p.clone(), |drift| p.scaled(drift.factor)));
            let drift_relative_u = drift.map(|drift| drift.relative_u);
            Ok(ReducedView { view: (*view).clone(), utc_us: run.view_time(view.id), patches, drift_relative_u })
        })
        .collect::<Result<Vec<_>>>()?;
    Ok(ReducedViews { views, darks })
}

/// Steps of each view.
fn brackets(run: &Run) -> BTreeMap<u32, Vec<&Step>> {
    let mut brackets: BTreeMap<u32, Vec<&Step>> = BTreeMap::new();
    for step in &run.document.plan.steps {
        brackets.entry(step.view).or_default().push(step);
    }
    brackets
}

/// Integration time as read back and pixels of every stored frame of a view.
fn frames_of(run: &Run, view: &View, steps: &[&Step]) -> Result<Vec<(f64, Pixels)>> {
    let mut frames = Vec::new();
    for step in steps {
        let Some(row) = run.frames.get(&step.number) else { continue };
        let pixels = run.dir.frames().read_frame(&view.camera, view.array_index, step.exposure_index)?;
        let Some(pixels) = pixels else {
            return Err(ProductError::Nothing(format!(
                "the journal lists the frame of step {}, but the frame store lacks it; run `goniod verify`",
                step.number
            )));
        };
        frames.push((row.exposure_us as f64 / 1e6, pixels));
    }
    Ok(frames)
}

fn merge_view(view: &View, optics: &CameraOptics, dark: &Dark, frames: &[(f64, Pixels)]) -> Result<ViewPatches> {
    let map = match &view.subject {
        Subject::Sample { side, .. } if side.flipped() => &optics.flipped,
        _ => &optics.straight,
    };
    merge_frames(map, optics, dark, frames).map_err(engine(format!("view {}", view.id)))
}

fn merge_frames(
    map: &PixelMap,
    optics: &CameraOptics,
    dark: &Dark,
    frames: &[(f64, Pixels)],
) -> std::result::Result<ViewPatches, crate::engine::error::EngineError> {
    let bytes = eights(frames);
    if bytes.is_empty() {
        merge(map, &optics.table, dark, &sixteens(frames))
    } else {
        merge(map, &optics.table, dark, &bytes)
    }
}

fn eights(frames: &[(f64, Pixels)]) -> Vec<Exposure<'_, u8>> {
    frames
        .iter()
        .filter_map(|(t_s, p)| match p {
            Pixels::U8(pixels) => Some(Exposure { t_s: *t_s, pixels: &pixels[..] }),
            Pixels::U16(_) => None,
        })
        .collect()
}

fn sixteens(frames: &[(f64, Pixels)]) -> Vec<Exposure<'_, u16>> {
    frames
        .iter()
        .filter_map(|(t_s, p)| match p {
            Pixels::U16(pixels) => Some(Exposure { t_s: *t_s, pixels: &pixels[..] }),
            Pixels::U8(_) => None,
        })
        .collect()
}

/// Dark rate from all dark views of a camera.
fn dark_of(run: &Run, camera: &str, optics: &CameraOptics, brackets: &BTreeMap<u32, Vec<&Step>>) -> Result<Dark> {
    let mut frames = Vec::new();
    for view in run.document.plan.views.iter().filter(|v| v.camera == camera && v.subject == Subject::Dark) {
        frames.extend(frames_of(run, view, brackets.get(&view.id).map_or(&[][..], Vec::as_slice))?);
    }
    if frames.is_empty() {
        return Err(ProductError::Nothing(format!(
            "camera `{camera}` has no dark frame in this run, so its dark signal is unknown; measure darks first"
        )));
    }
    let bytes = eights(&frames);
    let dark = if bytes.is_empty() {
        Dark::estimate(&optics.table, &sixteens(&frames))
    } else {
        Dark::estimate(&optics.table, &bytes)
    };
    dark.map_err(engine(format!("the dark frames of camera `{camera}`")))
}
