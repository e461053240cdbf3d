//! Sample over reference, channel by channel (eq. 1), then bands and totals patch by patch: the columns of the result.

use super::inputs::Run;
use super::optics::basis;
use super::readings::{Reading, Readings};
use super::views::{ReducedView, ReducedViews};
use super::{DarkFacts, Facts, Reduction};
use crate::config::scan::ReferenceMode;
use crate::control::plan::Subject;
use crate::engine::bsdf::budget::PatchBsdf;
use crate::engine::bsdf::hemispherical::hemispherical;
use crate::engine::bsdf::normalise::{AbsoluteTerms, RatioTerms, absolute, ratio};
use crate::engine::bsdf::patches::ViewPatches;
use crate::engine::bsdf::set::{BsdfSet, Column, Quantity};
use crate::engine::bsdf::totals::combine;
use crate::engine::optics::direction::Direction;
use crate::engine::optics::side::Side;
use crate::products::error::{ProductError, Result, engine};
use rayon::prelude::*;

/// Views whose disagreement is told one by one.
const MOST_TOLD: usize = 8;

/// One measured geometry.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Pose {
    side: Side,
    incident: Direction,
}

/// Everything a column is made from.
struct Maker<'a> {
    run: &'a Run,
    readings: &'a Readings,
    views: &'a ReducedViews,
}

/// All columns of the run.
pub fn columns(run: &Run, readings: &Readings, views: &ReducedViews) -> Result<Reduction> {
    let maker = Maker { run, readings, views };
    let poses = maker.poses();
    if poses.is_empty() {
        return Err(ProductError::Nothing("the run has no frame of the sample, so there is nothing to reduce".into()));
    }
    let made = poses.par_iter().map(|pose| maker.columns_of(*pose)).collect::<Result<Vec<_>>>()?;
    let mut facts = maker.facts();
    let mut columns = Vec::new();
    let projected = basis(run).projected_solid_angles();
    let quantities: Vec<Quantity> = readings.quantities.iter().map(|(q, _)| q.clone()).collect();
    let headline = Quantity::headline(&quantities);
    for (pose_columns, patches) in made {
        for p in patches.iter().flatten() {
            facts.largest_saturated = facts.largest_saturated.max(p.missing);
        }
        if let (Some(column), Some(list)) = (pose_columns.get(headline), patches.get(headline)) {
            facts.floor_relative = facts.floor_relative.max(floor_relative(&projected, column, list));
        }
        facts.add_budget(&patches);
        columns.extend(pose_columns);
    }
    facts.finish_budget();
    Ok(Reduction { set: BsdfSet { basis: basis(run), quantities, columns }, facts })
}

/// What light below the floor may add to the hemispherical value of a column, relative, k = 2.
fn floor_relative(projected: &[f64], column: &Column, patches: &[PatchBsdf]) -> f64 {
    let floor: f64 = projected.iter().zip(patches).map(|(l, p)| l * p.budget.floor).sum();
    if column.hemispherical > 0.0 { 2.0 * floor / column.hemispherical } else { 0.0 }
}

// === impl Maker ===

impl Maker<'_> {
    /// Geometries with at least one frame, ordered by side, theta, phi.
    fn poses(&self) -> Vec<Pose> {
        let mut poses: Vec<Pose> = Vec::new();
        for v in self.views.views.iter().filter(|v| v.patches.is_some()) {
            if let Subject::Sample { side, incident } = v.view.subject {
                let pose = Pose { side, incident };
                if !poses.contains(&pose) {
                    poses.push(pose);
                }
            }
        }
        poses.sort_by(|a, b| {
            let key = |p: &Pose| (p.side, p.incident.theta, p.incident.phi);
            key(a).partial_cmp(&key(b)).unwrap_or(std::cmp::Ordering::Equal)
        });
        poses
    }

    /// One column a quantity, and the patches they were made from (for the facts).
    fn columns_of(&self, pose: Pose) -> Result<(Vec<Column>, Vec<Vec<PatchBsdf>>)> {
        let n = basis(self.run).len();
        let absent = vec![PatchBsdf::nothing(); n];
        let measured: Vec<Vec<PatchBsdf>> = self
            .readings
            .readings
            .iter()
            .map(|reading| Ok(self.reading(pose, reading)?.unwrap_or_else(|| absent.clone())))
            .collect::<Result<_>>()?;
        let lists: Vec<&[PatchBsdf]> = measured.iter().map(Vec::as_slice).collect();
        let (theta, phi) = pose.incident.degrees();
        let what = || format!("{:?} at theta {theta:.1}, phi {phi:.1}", pose.side);
        let mut columns = Vec::new();
        let mut kept = Vec::new();
        for (index, (_, combiner)) in self.readings.quantities.iter().enumerate() {
            let patches = combine(combiner, &lists).map_err(engine(what()))?;
            let sum = hemispherical(&basis(self.run), &patches).map_err(engine(what()))?;
            columns.push(Column {
                side: pose.side,
                incident: pose.incident,
                quantity: index,
                patches: patches.iter().map(PatchBsdf::value).collect(),
                hemispherical: sum.value,
                hemispherical_u: sum.u,
            });
            kept.push(patches);
        }
        Ok((columns, kept))
    }

    /// BSDF of one reading in one geometry; `None` if its view has no frames.
    fn reading(&self, pose: Pose, reading: &Reading) -> Result<Option<Vec<PatchBsdf>>> {
        let subject = Subject::Sample { side: pose.side, incident: pose.incident };
        let view = self.views.views.iter().find(|v| {
            v.view.subject == subject && v.view.band.as_deref() == Some(&reading.band) && v.patches.is_some()
        });
        let Some(view) = view else { return Ok(None) };
        let Some(sample) = view.patches.as_ref().and_then(|p| p.channels.get(reading.channel)) else {
            return Ok(None);
        };
        let what = format!("band `{}`, channel {}", reading.band, reading.channel);
        match self.run.document.scan.reference.mode {
            ReferenceMode::Irradiance => {
                absolute(sample, &self.absolute_terms(pose, reading, view)).map(Some).map_err(engine(what))
            }
            ReferenceMode::Diffuser => {
                let Some((reference, terms)) = self.reference(pose, reading, view)? else { return Ok(None) };
                let Some(reference) = reference.channels.get(reading.channel) else { return Ok(None) };
                // The diffuser is photographed unturned; the sample may be turned. Patch by patch of the camera's
                // hemisphere the two must meet, so a turned sample needs the mirrored patch of the reference.
                let reference = if pose.side.flipped() { self.mirrored(reference) } else { reference.clone() };
                ratio(sample, &reference, &terms).map(Some).map_err(engine(what))
            }
        }
    }

    /// Patches of an unturned view in the order of a turned one: azimuth phi becomes 180 - phi.
    fn mirrored<T: Clone>(&self, patches: &[T]) -> Vec<T> {
        let basis = basis(self.run);
        let of = |i: usize| {
            let (ring, k) = basis.place(i)?;
            let n = basis.rings.get(ring)?.patches;
            let mirror = (n + n / 2 - k % n) % n;
            patches.get(basis.index(ring, mirror)).cloned()
        };
        (0..patches.len()).filter_map(of).collect()
    }

    /// The reference of this reading at the time of `view`, between the views before and after it.
    fn reference(
        &self,
        pose: Pose,
        reading: &Reading,
        view: &ReducedView,
    ) -> Result<Option<(ViewPatches, RatioTerms)>> {
        let transmission = pose.side.is_transmission();
        let instrument = &self.run.document.instrument;
        let standard = if transmission { &instrument.reference.transmission } else { &instrument.reference.reflection };
        let (Some(standard), Some(value)) = (standard, reading.references[usize::from(transmission)]) else {
            return Ok(None);
        };
        let wanted = Subject::Reference { transmission };
        let mut known: Vec<(i64, &ViewPatches)> = self
            .views
            .views
            .iter()
            .filter(|v| v.view.subject == wanted && v.view.band.as_deref() == Some(&reading.band))
            .filter_map(|v| Some((v.utc_us?, v.patches.as_ref()?)))
            .collect();
        known.sort_by_key(|(t, _)| *t);
        let largest = |a: Option<f64>, b: f64| Some(a.map_or(b, |a| a.max(b)));
        let references = self.views.views.iter().filter(|v| v.view.subject == wanted);
        let scaled = references.clone().filter_map(|v| v.drift_relative_u).fold(None, largest);
        let of_band = references.filter(|v| v.view.band.as_deref() == Some(&reading.band));
        let brackets =
            of_band.map(ReducedView::bracket_relative_u).fold(0.0, f64::max).hypot(view.bracket_relative_u());
        let Some(reference) = at_time(&known, view.utc_us.unwrap_or_default())? else { return Ok(None) };
        let terms = RatioTerms {
            reference_bsdf: value / std::f64::consts::PI,
            reference_relative_u: standard.relative_uncertainty,
            reference_theta: standard.theta_deg.to_radians(),
            theta: pose.incident.theta,
            theta_u: instrument.holder.tilt.tolerance_deg.to_radians() / 3.0_f64.sqrt(),
            // Where the light monitor told the lamp's level, what is left is the uncertainty of both scalings.
            drift_relative_u: brackets.hypot(match (view.drift_relative_u, scaled) {
                (Some(sample), Some(reference)) => sample.hypot(reference),
                _ => instrument.lamp.drift_relative_uncertainty,
            }),
        };
        Ok(Some((reference, terms)))
    }

    fn absolute_terms(&self, pose: Pose, reading: &Reading, view: &ReducedView) -> AbsoluteTerms {
        let instrument = &self.run.document.instrument;
        let calibration = self.run.document.calibrations.get(&reading.camera);
        let scale = calibration.map_or(0.0, |c| c.responsivity.scale_relative_uncertainty);
        let shape = calibration.map_or(0.0, |c| c.responsivity.shape_relative_uncertainty);
        let lamp = instrument.lamp.irradiance_relative_uncertainty.unwrap_or(0.0);
        AbsoluteTerms {
            one_over_h: reading.one_over_h,
            irradiance: reading.irradiance,
            scale_relative_u: scale.hypot(shape).hypot(lamp),
            vignetting_relative_u: calibration.map_or(0.0, |c| c.vignetting.relative_uncertainty),
            theta: pose.incident.theta,
            theta_u: instrument.holder.tilt.tolerance_deg.to_radians() / 3.0_f64.sqrt(),
            drift_relative_u: view
                .drift_relative_u
                .unwrap_or(instrument.lamp.drift_relative_uncertainty)
                .hypot(view.bracket_relative_u()),
        }
    }

    fn facts(&self) -> Facts {
        let samples = || self.views.views.iter().filter(|v| matches!(v.view.subject, Subject::Sample { .. }));
        let mut facts = Facts {
            views_reduced: samples().filter(|v| v.patches.is_some()).count(),
            views_missing: samples().filter(|v| v.patches.is_none()).count(),
            largest_reference_change: self.largest_reference_change(),
            ..Facts::default()
        };
        for (camera, dark) in self.views.darks.iter().flat_map(|(camera, darks)| darks.iter().map(move |d| (camera, d)))
        {
            facts.darks.push(DarkFacts {
                camera: camera.clone(),
                u_rate: dark.u_rate,
                u_common: dark.u_common,
                hot_pixels: dark.hot,
                unreadable_pixels: dark.unreadable,
            });
        }
        facts.notes.extend(disagreements(&self.views.views));
        for (name, camera) in &self.run.document.instrument.camera {
            facts.notes.extend(camera.format.caution().map(|caution| format!("camera `{name}`: {caution}")));
        }
        facts
    }

    /// Largest relative change between neighbouring views of the same reference.
    fn largest_reference_change(&self) -> Option<f64> {
        let mut largest: Option<f64> = None;
        let references: Vec<&ReducedView> =
            self.views.views.iter().filter(|v| matches!(v.view.subject, Subject::Reference { .. })).collect();
        for (i, a) in references.iter().enumerate() {
            let same = |b: &&&ReducedView| b.view.subject == a.view.subject && b.view.band == a.view.band;
            let Some(b) = references.iter().skip(i + 1).find(same) else { continue };
            let (Some(pa), Some(pb)) = (&a.patches, &b.patches) else { continue };
            for channel in 0..pa.channels.len() {
                if let Some(ratio) = pa.drift_to(pb, channel) {
                    largest = Some(largest.unwrap_or(0.0).max((ratio - 1.0).abs()));
                }
            }
        }
        largest
    }
}

/// Views whose exposures tell different light, a sentence each; beyond the first few only how many.
fn disagreements(views: &[ReducedView]) -> Vec<String> {
    let told = |view: &ReducedView| {
        let a = view.disagreement?;
        Some(format!(
            "View {} (camera `{}`, band `{}`): its exposure of {} s tells {:+.1} % light against that of {} s, noise and \
             response explain {:.1} %; the light changed meanwhile, the uncertainty is widened.",
            view.view.id,
            view.view.camera,
            view.view.band.as_deref().unwrap_or("none"),
            a.long_s,
            100.0 * a.change,
            a.short_s,
            100.0 * (a.change.abs() - a.unexplained())
        ))
    };
    let mut lines: Vec<String> = views.iter().filter_map(told).collect();
    let more = lines.len().saturating_sub(MOST_TOLD);
    lines.truncate(MOST_TOLD);
    lines.extend((more > 0).then(|| format!("The exposures of {more} more views disagree in the same way.")));
    lines
}

/// The view at time `t`: between its neighbours, or the nearest one.
fn at_time(known: &[(i64, &ViewPatches)], t: i64) -> Result<Option<ViewPatches>> {
    let before = known.iter().rev().find(|(k, _)| *k <= t);
    let after = known.iter().find(|(k, _)| *k > t);
    Ok(match (before, after) {
        (Some((t0, a)), Some((t1, b))) => {
            let weight = (t - t0) as f64 / (t1 - t0) as f64;
            Some(a.interpolate(b, weight).map_err(engine("the reference views"))?)
        }
        (Some((_, v)), None) | (None, Some((_, v))) => Some((*v).clone()),
        (None, None) => None,
    })
}

// === impl Facts ===

/// Names of the parts of the budget, in the order they are told.
const PARTS: [&str; 12] = [
    "counting noise and quantisation",
    "below the floor",
    "dark signal",
    "response curve",
    "reference or scale",
    "lamp drift",
    "direction of emergence",
    "point spread over patch borders",
    "incident angle",
    "vignetting",
    "spectrum between the bands",
    "saturated pixels",
];

impl Facts {
    /// Adds squares of the parts of the last quantity's patches (sum of squares; the mean square value comes last).
    fn add_budget(&mut self, quantities: &[Vec<PatchBsdf>]) {
        if self.budget.is_empty() {
            self.budget = PARTS.iter().map(|p| ((*p).to_owned(), 0.0)).collect();
            self.budget.push(("value".to_owned(), 0.0));
        }
        let Some(patches) = quantities.last() else { return };
        for p in patches.iter().filter(|p| p.bsdf.is_finite()) {
            let b = &p.budget;
            let parts = [
                b.random,
                b.floor,
                b.dark,
                b.response,
                b.scale,
                b.drift,
                b.geometry[0].hypot(b.geometry[1]),
                b.geometry[2].abs(),
                b.incidence,
                b.vignetting,
                b.spectral,
                b.missing,
                p.bsdf,
            ];
            for ((_, sum), part) in self.budget.iter_mut().zip(parts) {
                *sum += part * part;
            }
        }
    }

    /// Turns sums of squares into parts relative to the root mean square value.
    fn finish_budget(&mut self) {
        let value = self.budget.pop().map_or(0.0, |(_, v)| v);
        for (_, part) in &mut self.budget {
            *part = if value > 0.0 { (*part / value).sqrt() } else { 0.0 };
        }
    }
}
