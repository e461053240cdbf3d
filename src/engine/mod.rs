//! What the pictures mean: from digital levels to radiance and BSDF with uncertainty. Pure: no I/O, no clock, no device.
//!
//! levels -> [`radiometry`] (response, dark, vignetting, bracket merge) -> [`optics`] (pixel -> direction -> patch)
//! -> [`bsdf`] (normalise, eq. 1) -> [`spectra`] (bands -> totals, eq. 14 through a partition of unity).

pub mod bsdf;
pub mod error;
pub mod optics;
pub mod radiometry;
pub mod spectra;
