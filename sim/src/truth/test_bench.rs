//! The shipped bench for this crate's own tests.
#![allow(clippy::unwrap_used, clippy::expect_used)]

use super::config::BenchFile;
use super::photo::{Exposure, Photographer, Stage};
use super::sample::Sample;
use crate::pose::Pose;
use std::path::PathBuf;
use std::sync::Arc;

/// A file below config/sim.
pub fn path(name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../../config/sim").join(name)
}

/// The shipped bench, with or without randomness.
pub fn file(ideal: bool) -> BenchFile {
    let folder = tempfile::tempdir().unwrap();
    let text = std::fs::read_to_string(path("bench.toml")).unwrap();
    let text = text.replace("ideal = false", &format!("ideal = {ideal}"));
    let copy = folder.path().join("bench.toml");
    std::fs::write(&copy, text).unwrap();
    BenchFile::read(&copy).unwrap()
}

/// One camera of a bench with a shipped sample.
pub fn photographer(file: BenchFile, sample: &str, camera: &str) -> Photographer {
    let sample = Sample::read(&path(&format!("samples/{sample}.toml"))).unwrap();
    let stage = Stage::new(file, &path("bench.toml"), sample, 1).unwrap();
    Photographer::new(Arc::new(stage), &path("bench.toml"), camera, 1).unwrap()
}

/// One still exposure.
pub fn still(tilt_deg: f64, spin_deg: f64, changer_deg: f64, slot: u8, seconds: f64) -> Exposure {
    let pose = Pose { tilt_deg, spin_deg, changer_deg, slot: Some(slot), shutter_open: true };
    Exposure { poses: vec![(1.0, pose)], seconds, lamp: 1.0 }
}
