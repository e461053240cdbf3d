//! The result: BSDF values with uncertainty for every hemisphere, incident direction, quantity and emergent patch.

use crate::optics::basis::AngleBasis;
use crate::optics::direction::Direction;
use crate::optics::side::Side;
use serde::{Deserialize, Serialize};

/// What a value is averaged over in wavelength.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum Quantity {
    /// One filter band, lamp-weighted mean over its kernel (eq. 1).
    Band {
        /// Name, e.g. `f3`.
        name: String,
        /// Interval in nm.
        interval_nm: [f64; 2],
    },
    /// Lamp-weighted radiometric total over the interval (eq. 14 through a partition of unity).
    RadiometricTotal {
        /// Interval in nm.
        interval_nm: [f64; 2],
    },
    /// D65 x V(lambda).
    Visible,
    /// ASTM G173 direct, over the measured interval; the rest is extrapolated.
    Solar {
        /// Interval that was measured, nm.
        measured_nm: [f64; 2],
    },
}

/// One emergent patch.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct PatchValue {
    /// Patch mean of the BSDF, 1/sr, weighted by projected solid angle; NaN where nothing was measured.
    pub bsdf: f64,
    /// Standard uncertainty of it (k = 1), all components.
    pub u: f64,
    /// The part of `u` that is independent from patch to patch (counting noise, quantisation).
    pub u_random: f64,
    /// Fraction of the patch's projected solid angle that was measured, 0 to 1.
    pub coverage: f64,
    /// Largest single-pixel BSDF in the patch, 1/sr.
    pub max: f64,
}

/// All emergent patches for one incident direction in one hemisphere pair and one quantity.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Column {
    /// Hemisphere pair.
    pub side: Side,
    /// Vector to the source: theta from the normal on the source's side, azimuth about z (sample frame).
    pub incident: Direction,
    /// Index into `BsdfSet::quantities`.
    pub quantity: usize,
    /// One value a patch of the emergent basis, in file order (emergent direction in sample frame).
    pub patches: Vec<PatchValue>,
    /// Direct-hemispherical transmittance or reflectance: sum of projected solid angle x BSDF.
    pub hemispherical: f64,
    /// Standard uncertainty of it, correlated parts taken as fully correlated.
    pub hemispherical_u: f64,
}

/// The whole result of a run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct BsdfSet {
    /// Emergent basis.
    pub basis: AngleBasis,
    /// What was computed.
    pub quantities: Vec<Quantity>,
    /// Every measured column, ordered by side, incident direction, quantity.
    pub columns: Vec<Column>,
}

// === impl Quantity ===

impl Quantity {
    /// Index of the quantity that speaks for a result: Visible where there is one, else the lamp-weighted total, else
    /// the first.
    pub fn headline(quantities: &[Quantity]) -> usize {
        let at = |wanted: fn(&Quantity) -> bool| quantities.iter().position(wanted);
        at(|q| *q == Quantity::Visible).or_else(|| at(|q| matches!(q, Quantity::RadiometricTotal { .. }))).unwrap_or(0)
    }

    /// Short name for files and plots.
    pub fn name(&self) -> String {
        match self {
            Quantity::Band { name, .. } => name.clone(),
            Quantity::RadiometricTotal { .. } => "total".to_owned(),
            Quantity::Visible => "visible".to_owned(),
            Quantity::Solar { .. } => "solar".to_owned(),
        }
    }
}
