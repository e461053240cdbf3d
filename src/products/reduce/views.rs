//! Brackets of frames -> patch means, view by view. Views are independent and reduced side by side.

use super::inputs::Run;
use super::optics::CameraOptics;
use super::planes::planes;
use crate::control::plan::{Step, Subject, View};
use crate::engine::bsdf::patches::ViewPatches;
use crate::engine::error::EngineError;
use crate::engine::optics::pixel_map::PixelMap;
use crate::engine::radiometry::agreement::{Agreement, agreement};
use crate::engine::radiometry::dark::Dark;
use crate::engine::radiometry::levels::Reading;
use crate::engine::radiometry::merge::{Exposure, merge};
use crate::engine::radiometry::sums::SumLevel;
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
    /// The two exposures that differ most beyond what noise and response explain; `None` where all agree.
    pub disagreement: Option<Agreement>,
}

// === impl ReducedView ===

impl ReducedView {
    /// Relative standard uncertainty from what the exposures of the bracket disagree: as a rectangular distribution.
    pub fn bracket_relative_u(&self) -> f64 {
        self.disagreement.map_or(0.0, |a| a.unexplained() / 3.0_f64.sqrt())
    }
}

/// All views of a run.
pub struct ReducedViews {
    /// In the order of the plan, darks left out.
    pub views: Vec<ReducedView>,
    /// Dark rate of each camera: one, or one a colour where its pixels hold several values.
    pub darks: BTreeMap<String, Vec<Dark>>,
}

/// Reduces every reference and sample view.
pub fn reduce_views(run: &Run, cameras: &BTreeMap<String, CameraOptics>) -> Result<ReducedViews> {
    let brackets = brackets(run);
    let mut darks = BTreeMap::new();
    for (name, optics) in cameras {
        darks.insert(name.clone(), darks_of(run, name, optics, &brackets)?);
    }
    let wanted: Vec<&View> = run.document.plan.views.iter().filter(|v| v.subject != Subject::Dark).collect();
    let views = wanted
        .par_iter()
        .map(|view| {
            let lost = || ProductError::Nothing(format!("the plan uses camera `{}`, which the run lacks", view.camera));
            let optics = cameras.get(&view.camera).ok_or_else(lost)?;
            let darks = darks.get(&view.camera).ok_or_else(lost)?;
            let frames = frames_of(run, view, brackets.get(&view.id).map_or(&[][..], Vec::as_slice))?;
            let merged = if frames.is_empty() { None } else { Some(merge_view(view, optics, darks, &frames)?) };
            let (patches, disagreement) = merged.map_or((None, None), |m| (Some(m.patches), m.disagreement));
            let drift = run.drift_factor(view.id);
            let patches = patches.map(|p| drift.map_or_else(|| p.clone(), |drift| p.scaled(drift.factor)));
            let drift_relative_u = drift.map(|drift| drift.relative_u);
            let utc_us = run.view_time(view.id);
            Ok(ReducedView { view: (*view).clone(), utc_us, patches, drift_relative_u, disagreement })
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

/// A stored frame: its integration time as read back (of one exposure, where it is a sum), exposures in it, pixels.
struct Stored {
    t_s: f64,
    exposures: u16,
    pixels: Pixels,
}

/// Every stored frame of a view, colour by colour: one list, or three where pixels hold several values.
fn frames_of(run: &Run, view: &View, steps: &[&Step]) -> Result<Vec<Vec<Stored>>> {
    let camera = run.document.instrument.camera.get(&view.camera);
    let mut frames: Vec<Vec<Stored>> = Vec::new();
    for step in steps {
        let Some(row) = run.frames.get(&step.number) else { continue };
        let (array, exposure) = (view.array_index, step.exposure_index);
        let pixels = run.dir.frames().read_proven(&view.camera, array, exposure, &row.digest)?;
        let Some(pixels) = pixels else {
            return Err(ProductError::Nothing(format!(
                "the journal lists the frame of step {}, but the frame store lacks it; run `goniod verify`",
                step.number
            )));
        };
        let exposures = camera.map_or(1, |c| c.frames_in(step.exposure.seconds()));
        let t_s = row.exposure_us as f64 / 1e6 / f64::from(exposures);
        let colours = camera.map_or_else(|| vec![pixels.clone()], |c| planes(c.format, pixels.clone()));
        frames.resize_with(colours.len(), Vec::new);
        for (list, pixels) in frames.iter_mut().zip(colours) {
            list.push(Stored { t_s, exposures, pixels });
        }
    }
    Ok(frames)
}

/// A merged bracket.
struct Merged {
    patches: ViewPatches,
    disagreement: Option<Agreement>,
}

fn merge_view(view: &View, optics: &CameraOptics, darks: &[Dark], frames: &[Vec<Stored>]) -> Result<Merged> {
    let map = match &view.subject {
        Subject::Sample { side, .. } if side.flipped() => &optics.flipped,
        _ => &optics.straight,
    };
    let (mut channels, mut disagreement) = (Vec::new(), None);
    for (dark, colour) in darks.iter().zip(frames) {
        let merged = merge_frames(map, optics, dark, colour).map_err(engine(format!("view {}", view.id)))?;
        channels.extend(merged.patches.channels);
        disagreement = worse(disagreement, merged.disagreement);
    }
    Ok(Merged { patches: ViewPatches { channels }, disagreement })
}

/// The one of two that is explained less.
fn worse(a: Option<Agreement>, b: Option<Agreement>) -> Option<Agreement> {
    a.into_iter().chain(b).max_by(|a, b| a.unexplained().total_cmp(&b.unexplained()))
}

fn merge_frames(
    map: &PixelMap,
    optics: &CameraOptics,
    dark: &Dark,
    frames: &[Stored],
) -> std::result::Result<Merged, EngineError> {
    if is_summed(frames) {
        let levels: Vec<Vec<SumLevel>> = frames.iter().map(Stored::levels).collect();
        return merged(map, optics, dark, &sums(frames, &levels));
    }
    let bytes = eights(frames);
    if bytes.is_empty() { merged(map, optics, dark, &sixteens(frames)) } else { merged(map, optics, dark, &bytes) }
}

fn merged<P: Reading>(
    map: &PixelMap,
    optics: &CameraOptics,
    dark: &Dark,
    exposures: &[Exposure<'_, P>],
) -> std::result::Result<Merged, EngineError> {
    let patches = merge(map, &optics.table, dark, exposures)?;
    let unexplained = agreement(map, &optics.table, dark, exposures).into_iter().filter(|a| a.unexplained() > 0.0);
    Ok(Merged { patches, disagreement: unexplained.fold(None, |worst, a| worse(worst, Some(a))) })
}

fn is_summed(frames: &[Stored]) -> bool {
    frames.iter().any(|f| f.exposures > 1)
}

fn eights(frames: &[Stored]) -> Vec<Exposure<'_, u8>> {
    frames
        .iter()
        .filter_map(|f| match &f.pixels {
            Pixels::U8(pixels) => Some(Exposure { t_s: f.t_s, pixels: &pixels[..] }),
            Pixels::U16(_) => None,
        })
        .collect()
}

fn sixteens(frames: &[Stored]) -> Vec<Exposure<'_, u16>> {
    frames
        .iter()
        .filter_map(|f| match &f.pixels {
            Pixels::U16(pixels) => Some(Exposure { t_s: f.t_s, pixels: &pixels[..] }),
            Pixels::U8(_) => None,
        })
        .collect()
}

fn sums<'a>(frames: &[Stored], levels: &'a [Vec<SumLevel>]) -> Vec<Exposure<'a, SumLevel>> {
    frames.iter().zip(levels).map(|(f, pixels)| Exposure { t_s: f.t_s, pixels: &pixels[..] }).collect()
}

// === impl Stored ===

impl Stored {
    fn levels(&self) -> Vec<SumLevel> {
        let exposures = self.exposures;
        let of = |level: u16| SumLevel { level, exposures };
        match &self.pixels {
            Pixels::U8(v) => v.iter().map(|b| of(u16::from(*b))).collect(),
            Pixels::U16(v) => v.iter().map(|w| of(*w)).collect(),
        }
    }
}

/// Dark rates from all dark views of a camera.
fn darks_of(run: &Run, camera: &str, optics: &CameraOptics, brackets: &BTreeMap<u32, Vec<&Step>>) -> Result<Vec<Dark>> {
    let mut frames: Vec<Vec<Stored>> = Vec::new();
    for view in run.document.plan.views.iter().filter(|v| v.camera == camera && v.subject == Subject::Dark) {
        let more = frames_of(run, view, brackets.get(&view.id).map_or(&[][..], Vec::as_slice))?;
        frames.resize_with(more.len().max(frames.len()), Vec::new);
        frames.iter_mut().zip(more).for_each(|(list, more)| list.extend(more));
    }
    if frames.is_empty() {
        return Err(ProductError::Nothing(format!(
            "camera `{camera}` has no dark frame in this run, so its dark signal is unknown; measure darks first"
        )));
    }
    frames.iter().map(|list| dark_of(camera, optics, list)).collect()
}

fn dark_of(camera: &str, optics: &CameraOptics, frames: &[Stored]) -> Result<Dark> {
    let bytes = eights(frames);
    let dark = if is_summed(frames) {
        let levels: Vec<Vec<SumLevel>> = frames.iter().map(Stored::levels).collect();
        Dark::estimate(&optics.table, &sums(frames, &levels), optics.reserved)
    } else if bytes.is_empty() {
        Dark::estimate(&optics.table, &sixteens(frames), optics.reserved)
    } else {
        Dark::estimate(&optics.table, &bytes, optics.reserved)
    };
    dark.map_err(engine(format!("the dark frames of camera `{camera}`")))
}
