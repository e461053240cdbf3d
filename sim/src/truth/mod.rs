//! The truth of the simulated bench: its own optics, radiometry and samples, computed from physics without the engine.
//!
//! - [`error`]: one error type for everything that is read from files
//! - [`vector`]: small vectors and the frames of camera and sample
//! - [`spectrum`]: curves on the bench's 5 nm grid, glass stacks
//! - [`config`]: `bench.toml`; [`draw`]: how the bench as built differs from it
//! - [`lamp`]: the lamp over time, with what happens to it
//! - [`mirror`]: pixel to direction through fisheye and hemi-ellipsoid, by tracing rays
//! - [`law`], [`klems`], [`tree`], [`block`]: angular laws of samples; [`sample`]: their files
//! - [`response`], [`rng`]: exposure to level, noise
//! - [`blur`]: the lens's point spread
//! - [`pose`]: where everything that moves stands
//! - [`raster`]: what a camera's pixels see, cached; [`photo`]: photographs
//! - [`expect`]: the true answers, without any pixel

pub mod block;
pub mod blur;
pub mod config;
pub mod draw;
pub mod error;
pub mod expect;
pub mod klems;
pub mod lamp;
pub mod law;
pub mod mirror;
pub mod photo;
pub mod pose;
pub mod raster;
pub mod response;
pub mod rng;
pub mod sample;
pub mod spectrum;
pub mod tree;
pub mod vector;

#[cfg(test)]
mod photo_tests;
#[cfg(test)]
pub mod test_bench;
