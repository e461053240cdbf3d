//! Wavelengths: curves, filter stacks, kernels of the readings, combination of bands into totals.

pub mod combine;
pub mod curve;
pub mod filters;
pub mod kernels;
pub mod paper;
pub mod targets;
#[cfg(test)]
pub(crate) mod testdata;
