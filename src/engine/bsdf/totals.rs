//! Totals patch by patch: the readings of all bands and channels combined with optimal weights.

use super::budget::{Budget, PatchBsdf};
use crate::error::EngineError;
use crate::spectra::combine::{Combiner, Weights};
use std::collections::HashMap;

/// Readings of one patch below this coverage are not combined.
const LEAST_COVERAGE: f64 = 0.5;

/// Combines `readings` (one list of patches a reading, in the order of the combiner's kernels) into one list of
/// patches.
///
/// Random parts are independent between readings; every other part is one cause acting on all readings, but whether
/// its effects have the same sign is not always known (response, drift between bands), so the larger of the coherent
/// sum and the root of the sum of squares is taken. A patch uses the readings it has; which they are, and how sure each
/// of them is, changes its weights.
///
/// # Errors
/// As many readings as the combiner has kernels are needed, all with the same number of patches.
pub fn combine(combiner: &Combiner, readings: &[&[PatchBsdf]]) -> Result<Vec<PatchBsdf>, EngineError> {
    if readings.len() != combiner.readings() {
        let (expected, got) = (combiner.readings(), readings.len());
        return Err(EngineError::Length { what: "the list of readings to combine", expected, got });
    }
    let patches = readings.first().map_or(0, |r| r.len());
    if let Some(odd) = readings.iter().find(|r| r.len() != patches) {
        let what = "the patches of a reading";
        return Err(EngineError::Length { what, expected: patches, got: odd.len() });
    }
    let mut cache: HashMap<Vec<Option<u8>>, Option<Weights>> = HashMap::new();
    let mut out = Vec::with_capacity(patches);
    for patch in 0..patches {
        let here: Vec<PatchBsdf> =
            readings.iter().map(|r| r.get(patch).copied().unwrap_or(PatchBsdf::nothing())).collect();
        let weights = cache.entry(steps(combiner, &here)).or_insert_with_key(|steps| combiner.weights(steps));
        out.push(weights.as_ref().map_or(PatchBsdf::nothing(), |w| total(w, &here)));
    }
    Ok(out)
}

/// Standard uncertainty of a reading by itself: what other readings of the patch do not share, or not in the same measure.
fn own(p: &PatchBsdf) -> f64 {
    let b = &p.budget;
    [b.random, b.floor, b.dark, b.response, b.missing].iter().map(|u| u * u).sum::<f64>().sqrt()
}

/// How noisy each reading is, in steps of the combiner; `None` for one that is not used.
fn steps(combiner: &Combiner, readings: &[PatchBsdf]) -> Vec<Option<u8>> {
    let is_used = |p: &PatchBsdf| p.bsdf.is_finite() && p.coverage >= LEAST_COVERAGE;
    let used = readings.iter().filter(|p| is_used(p));
    let (sum, n) = used.fold((0.0, 0.0), |(sum, n), p| (sum + p.bsdf.abs(), n + 1.0));
    let step = |p: &PatchBsdf| combiner.noise_step(own(p) * n / sum);
    readings.iter().map(|p| is_used(p).then(|| step(p))).collect()
}

fn total(w: &Weights, readings: &[PatchBsdf]) -> PatchBsdf {
    let of = |f: fn(&PatchBsdf) -> f64| -> Vec<f64> { readings.iter().map(f).collect() };
    let (y, random) = (of(|p| p.bsdf), of(|p| p.budget.random));
    let cautious = |f: fn(&PatchBsdf) -> f64| {
        let u = of(f);
        w.correlated(&u).abs().max(w.independent(&u))
    };
    let budget = Budget {
        random: w.independent(&random),
        floor: cautious(|p| p.budget.floor),
        dark: cautious(|p| p.budget.dark),
        response: cautious(|p| p.budget.response),
        scale: w.correlated(&of(|p| p.budget.scale)).abs(),
        drift: cautious(|p| p.budget.drift),
        geometry: [
            w.correlated(&of(|p| p.budget.geometry[0])),
            w.correlated(&of(|p| p.budget.geometry[1])),
            w.correlated(&of(|p| p.budget.geometry[2])),
        ],
        incidence: w.correlated(&of(|p| p.budget.incidence)).abs(),
        vignetting: w.correlated(&of(|p| p.budget.vignetting)).abs(),
        spectral: w.spectral(&y, &of(own)),
        missing: cautious(|p| p.budget.missing),
    };
    let used = || readings.iter().zip(&w.c).filter(|(p, c)| **c != 0.0 && p.bsdf.is_finite()).map(|(p, _)| p);
    let bsdf = w.value(&y);
    PatchBsdf {
        bsdf,
        budget,
        coverage: used().map(|p| p.coverage).fold(1.0, f64::min),
        below_floor: used().map(|p| p.below_floor).fold(0.0, f64::max),
        missing: used().map(|p| p.missing).fold(0.0, f64::max),
        max: w.value(&of(|p| p.max)).max(bsdf),
        lower_bound: w.value(&of(|p| p.lower_bound)),
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used)]
    use super::*;
    use crate::spectra::combine::Prior;
    use crate::spectra::curve::Grid;
    use crate::spectra::kernels::Kernel;
    use crate::spectra::targets::radiometric;
    use crate::spectra::testdata;

    fn patch(bsdf: f64) -> PatchBsdf {
        let budget = Budget { random: 0.01 * bsdf, scale: 0.005 * bsdf, ..Budget::default() };
        PatchBsdf { bsdf, budget, coverage: 1.0, max: bsdf, lower_bound: bsdf, ..PatchBsdf::nothing() }
    }

    #[test]
    fn a_neutral_patch_is_exact_whatever_is_missing() {
        let grid = Grid::engine();
        let kernels = testdata::kernels(&grid);
        let kernels: Vec<&Kernel> = kernels.iter().collect();
        let target = radiometric(&grid, &grid.sample(&testdata::lamp()), [380.0, 945.0]);
        let combiner = Combiner::new(&grid, &kernels, &target, Prior::default()).unwrap();
        let mut readings = vec![vec![patch(0.2), patch(0.2), patch(0.2)]; 24];
        readings[3][1] = PatchBsdf::nothing();
        readings.iter_mut().for_each(|r| r[2] = PatchBsdf::nothing());
        let slices: Vec<&[PatchBsdf]> = readings.iter().map(Vec::as_slice).collect();
        let total = combine(&combiner, &slices).unwrap();
        for p in &total[..2] {
            assert!((p.bsdf / 0.2 - 1.0).abs() < 1e-9);
            assert_eq!(p.budget.spectral, 0.0);
            assert!((p.budget.scale - 0.001).abs() < 1e-12, "one scale for all readings");
            assert!(p.budget.random < 0.002 && p.budget.random > 0.0002, "noise averages down");
        }
        assert!(total[2].bsdf.is_nan() && total[2].coverage == 0.0);
        assert!(combine(&combiner, &slices[1..]).is_err());
    }
}
