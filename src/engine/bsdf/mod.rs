//! From radiance to BSDF: what was measured, how sure, over which patches.

pub mod budget;
pub mod fill;
pub mod hemispherical;
pub mod lint;
pub mod matrix;
pub mod normalise;
pub mod patches;
pub mod set;
pub mod totals;
