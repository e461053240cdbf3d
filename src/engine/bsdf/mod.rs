//! From radiance to BSDF: what was measured, how sure, over which patches.

pub mod patches;
pub mod set;
