//! What one view says patch by patch: mean relative exposure rate with the parts of its uncertainty.

use crate::error::EngineError;

/// One patch in one channel. Rates are relative exposures per second, x/t, after dark and vignetting.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PatchMean {
    /// Mean rate, weighted by projected solid angle, over what was measured or is below the floor; NaN if neither.
    pub rate: f64,
    /// Counting noise and quantisation, independent from patch to patch.
    pub u_random: f64,
    /// From pixels below the floor (floor/sqrt 12 each), fully correlated.
    pub u_floor: f64,
    /// From what is not known of the dark rate of all pixels, fully correlated.
    pub u_dark: f64,
    /// From the residual of the response curve, residual x s(N) x L, fully correlated.
    pub u_response: f64,
    /// Change for a shift by one standard uncertainty of direction along columns and rows, and what the point spread may
    /// have moved over the borders; signed, because what one patch loses its neighbour gains.
    pub u_geometry: [f64; 3],
    /// Share of the patch's projected solid angle that was measured.
    pub measured: f64,
    /// Share below the floor: black even in the longest exposure.
    pub below_floor: f64,
    /// Share missing: saturated even in the shortest exposure.
    pub missing: f64,
    /// Largest single-pixel rate (at least this, where pixels are missing).
    pub max: f64,
    /// Mean with the missing pixels at the least they can be.
    pub lower_bound: f64,
    /// Pixels that contributed.
    pub pixels: u64,
}

/// All patches of one view.
#[derive(Debug, Clone, PartialEq)]
pub struct ViewPatches {
    /// One list of patches a channel (R, G, B, or a single one), in file order.
    pub channels: Vec<Vec<PatchMean>>,
}

// === impl PatchMean ===

impl PatchMean {
    /// A patch of which nothing is known.
    pub fn nothing() -> PatchMean {
        PatchMean {
            rate: f64::NAN,
            u_random: 0.0,
            u_floor: 0.0,
            u_dark: 0.0,
            u_response: 0.0,
            u_geometry: [0.0; 3],
            measured: 0.0,
            below_floor: 0.0,
            missing: 0.0,
            max: 0.0,
            lower_bound: 0.0,
            pixels: 0,
        }
    }

    /// Share of the patch that has a value, measured or bounded by the floor.
    pub fn coverage(&self) -> f64 {
        self.measured + self.below_floor
    }

    fn scaled(&self, factor: f64) -> PatchMean {
        PatchMean {
            rate: self.rate * factor,
            u_random: self.u_random * factor,
            u_floor: self.u_floor * factor,
            u_dark: self.u_dark * factor,
            u_response: self.u_response * factor,
            u_geometry: self.u_geometry.map(|u| u * factor),
            max: self.max * factor,
            lower_bound: self.lower_bound * factor,
            ..*self
        }
    }

    fn blend(&self, other: &PatchMean, weight: f64) -> PatchMean {
        if self.rate.is_nan() || other.rate.is_nan() {
            return if self.rate.is_nan() { *other } else { *self };
        }
        let mix = |a: f64, b: f64| (1.0 - weight) * a + weight * b;
        PatchMean {
            rate: mix(self.rate, other.rate),
            u_random: ((1.0 - weight) * self.u_random).hypot(weight * other.u_random),
            u_floor: mix(self.u_floor, other.u_floor),
            u_dark: mix(self.u_dark, other.u_dark),
            u_response: mix(self.u_response, other.u_response),
            u_geometry: [0, 1, 2].map(|k| mix(self.u_geometry[k], other.u_geometry[k])),
            measured: mix(self.measured, other.measured),
            below_floor: mix(self.below_floor, other.below_floor),
            missing: mix(self.missing, other.missing),
            max: mix(self.max, other.max),
            lower_bound: mix(self.lower_bound, other.lower_bound),
            pixels: self.pixels.min(other.pixels),
        }
    }
}

// === impl ViewPatches ===

impl ViewPatches {
    /// Straight line between two views of the same thing (a reference before and after), `weight` = 0 at `self`, 1 at
    /// `other`. A patch that only one of them has is taken from it.
    ///
    /// # Errors
    /// Views of different shape.
    pub fn interpolate(&self, other: &ViewPatches, weight: f64) -> Result<ViewPatches, EngineError> {
        let shape = |v: &ViewPatches| v.channels.iter().map(Vec::len).sum::<usize>();
        if self.channels.len() != other.channels.len() || shape(self) != shape(other) {
            let (expected, got) = (shape(self), shape(other));
            return Err(EngineError::Length { what: "the second reference view", expected, got });
        }
        let weight = weight.clamp(0.0, 1.0);
        let channels = self
            .channels
            .iter()
            .zip(&other.channels)
            .map(|(a, b)| a.iter().zip(b).map(|(a, b)| a.blend(b, weight)).collect())
            .collect();
        Ok(ViewPatches { channels })
    }

    /// The view as it would be under another level of the lamp: every rate and its uncertainties times `factor`.
    pub fn scaled(&self, factor: f64) -> ViewPatches {
        let scale = |patches: &Vec<PatchMean>| patches.iter().map(|p| p.scaled(factor)).collect();
        ViewPatches { channels: self.channels.iter().map(scale).collect() }
    }

    /// Mean ratio other/self of one channel over patches both have, weighted by rate: how the lamp drifted between
    /// two views of the same thing. `None` if they share nothing.
    pub fn drift_to(&self, other: &ViewPatches, channel: usize) -> Option<f64> {
        let (a, b) = (self.channels.get(channel)?, other.channels.get(channel)?);
        let both = a.iter().zip(b).filter(|(a, b)| a.rate > 0.0 && b.rate > 0.0);
        let (sum_a, sum_b) = both.fold((0.0, 0.0), |s, (a, b)| (s.0 + a.rate, s.1 + b.rate));
        (sum_a > 0.0).then(|| sum_b / sum_a)
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used)]
    use super::*;

    #[test]
    fn a_reference_between_two_is_on_the_line_with_less_noise() {
        let at = |rate| ViewPatches {
            channels: vec![vec![PatchMean { rate, u_random: 1.0, measured: 1.0, ..PatchMean::nothing() }]],
        };
        let (a, b) = (at(100.0), at(104.0));
        let mid = a.interpolate(&b, 0.25).unwrap().channels[0][0];
        assert!((mid.rate - 101.0).abs() < 1e-12);
        assert!((mid.u_random - 0.75_f64.hypot(0.25)).abs() < 1e-12);
        assert!((a.drift_to(&b, 0).unwrap() - 1.04).abs() < 1e-12);
        let gap = ViewPatches { channels: vec![vec![PatchMean::nothing()]] };
        assert_eq!(gap.interpolate(&b, 0.1).unwrap().channels[0][0].rate, 104.0);
        assert!(a.interpolate(&ViewPatches { channels: vec![] }, 0.5).is_err());
    }
}
