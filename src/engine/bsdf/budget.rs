//! The uncertainty budget of one BSDF value, part by part (standard uncertainties in 1/sr, k = 1).

use super::set::PatchValue;

/// Named parts. `random` is independent from patch to patch; `geometry` moves light between patches; all others are
/// fully correlated over the patches of a column.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Budget {
    /// Counting noise and quantisation of sample and reference.
    pub random: f64,
    /// Pixels below the floor.
    pub floor: f64,
    /// Dark rate, as far as the dark frames leave it open for all pixels.
    pub dark: f64,
    /// Residual of the response curve.
    pub response: f64,
    /// Scale: the reference's value, or responsivity and irradiance in absolute mode.
    pub scale: f64,
    /// Lamp drift between sample and reference.
    pub drift: f64,
    /// Change for a shift of direction by one standard uncertainty along columns and rows, and what the point spread may
    /// have moved over the patch's border; signed.
    pub geometry: [f64; 3],
    /// Incident angle of the holder through cos(theta_i).
    pub incidence: f64,
    /// Vignetting (absolute mode only; a ratio cancels it).
    pub vignetting: f64,
    /// Spectrum between the kernels of the readings (totals only).
    pub spectral: f64,
    /// Saturated pixels: how much the mean must rise at least if they are counted.
    pub missing: f64,
}

/// One patch with its budget.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PatchBsdf {
    /// BSDF in 1/sr; NaN where nothing was measured.
    pub bsdf: f64,
    /// Its uncertainty.
    pub budget: Budget,
    /// Share of the patch that has a value.
    pub coverage: f64,
    /// Share of it that is only known to lie below the floor.
    pub below_floor: f64,
    /// Share that was saturated.
    pub missing: f64,
    /// Largest single pixel.
    pub max: f64,
    /// BSDF with saturated pixels at the least they can be.
    pub lower_bound: f64,
}

// === impl Budget ===

impl Budget {
    /// All parts that are fully correlated over a column, in a fixed order, as signed effects of one standard
    /// deviation of their cause.
    pub fn common(&self) -> [f64; 9] {
        [
            self.floor,
            self.dark,
            self.response,
            self.scale,
            self.drift,
            self.incidence,
            self.vignetting,
            self.spectral,
            self.missing,
        ]
    }

    /// All parts that are not random.
    pub fn systematic(&self) -> f64 {
        self.common().iter().chain(&self.geometry).map(|p| p * p).sum::<f64>().sqrt()
    }

    /// All parts together.
    pub fn total(&self) -> f64 {
        self.random.hypot(self.systematic())
    }
}

// === impl PatchBsdf ===

impl PatchBsdf {
    /// A patch of which nothing is known.
    pub fn nothing() -> PatchBsdf {
        PatchBsdf {
            bsdf: f64::NAN,
            budget: Budget::default(),
            coverage: 0.0,
            below_floor: 0.0,
            missing: 0.0,
            max: 0.0,
            lower_bound: 0.0,
        }
    }

    /// What goes into the result set.
    pub fn value(&self) -> PatchValue {
        PatchValue {
            bsdf: self.bsdf,
            u: if self.bsdf.is_nan() { f64::NAN } else { self.budget.total() },
            u_random: if self.bsdf.is_nan() { f64::NAN } else { self.budget.random },
            coverage: self.coverage,
            max: self.max,
        }
    }
}
