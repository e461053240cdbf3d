//! The simulated bench as a whole: opened from its file, a sample file and a seed; gives cameras and true answers.

use crate::camera::{FaultQueue, SimCamera};
use crate::gige::BenchScene;
use crate::pose::PoseSource;
use crate::truth::config::BenchFile;
use crate::truth::draw::LampDraw;
use crate::truth::error::{Result, SimError};
use crate::truth::expect::Expectation;
use crate::truth::photo::{Photographer, Stage};
use crate::truth::sample::Sample;
use crate::truth::spectrum::wavelength_nm;
use goniod_drivers::clock::Clock;
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicU64;
use tokio::time::Instant;

/// Everything the cameras of one bench share.
#[derive(Clone)]
pub struct Surroundings {
    /// Where everything stands.
    pub poses: Arc<dyn PoseSource>,
    /// Time.
    pub clock: Clock,
    /// The lamp's steadiness.
    pub lamp: Arc<LampDraw>,
    /// Instant at which the bench was opened.
    pub opened: Instant,
}

/// The bench.
pub struct Bench {
    stage: Arc<Stage>,
    cameras: BTreeMap<String, Seat>,
    surroundings: Surroundings,
}

/// What belongs to one camera for the bench's whole life.
#[derive(Clone)]
struct Seat {
    photographer: Arc<Photographer>,
    frames: Arc<AtomicU64>,
    faults: FaultQueue,
}

// === impl Bench ===

impl Bench {
    /// Opens the bench of `bench_toml` with the sample of `sample_toml` in the holder.
    ///
    /// # Errors
    /// A file that cannot be read, or is not what it should be, with path and place.
    pub fn open(
        bench_toml: &Path,
        sample_toml: &Path,
        seed: u64,
        poses: Arc<dyn PoseSource>,
        clock: Clock,
    ) -> Result<Bench> {
        Bench::assemble(BenchFile::read(bench_toml)?, bench_toml, sample_toml, seed, poses, clock)
    }

    /// The same from a description at hand (a test that switches noise off); paths in it are relative to `bench_toml`.
    ///
    /// # Errors
    /// As [`Bench::open`].
    pub fn assemble(
        file: BenchFile,
        bench_toml: &Path,
        sample_toml: &Path,
        seed: u64,
        poses: Arc<dyn PoseSource>,
        clock: Clock,
    ) -> Result<Bench> {
        let lamp = Arc::new(LampDraw::new(&file.lamp, seed));
        let stage = Arc::new(Stage::new(file, bench_toml, Sample::read(sample_toml)?, seed)?);
        let mut cameras = BTreeMap::new();
        for name in stage.file.camera.keys() {
            let photographer = Arc::new(Photographer::new(Arc::clone(&stage), bench_toml, name, seed)?);
            cameras.insert(name.clone(), Seat { photographer, frames: Arc::default(), faults: FaultQueue::default() });
        }
        Ok(Bench { stage, cameras, surroundings: Surroundings { poses, clock, lamp, opened: clock.now() } })
    }

    /// The bench's description in force.
    pub fn file(&self) -> &BenchFile {
        &self.stage.file
    }

    /// The camera `name` (`ccd`, `ingaas`) as a device.
    pub fn camera(&self, name: &str) -> Result<SimCamera> {
        let seat = self.seat(name)?;
        let (photographer, frames) = (Arc::clone(&seat.photographer), Arc::clone(&seat.frames));
        Ok(SimCamera::new(name, photographer, self.surroundings.clone(), frames, seat.faults.clone()))
    }

    /// What the camera `name` would photograph, as the scene of a GigE Vision twin with this sensor.
    pub fn scene(&self, name: &str) -> Result<BenchScene> {
        let photographer = Arc::clone(&self.seat(name)?.photographer);
        Ok(BenchScene::new(name, photographer, self.surroundings.clone()))
    }

    /// Faults to come of the camera `name`, shared by all its handles.
    pub fn faults(&self, name: &str) -> Result<FaultQueue> {
        Ok(self.seat(name)?.faults.clone())
    }

    /// The camera's optics without its electronics: exposures and NDL without noise.
    pub fn photographer(&self, name: &str) -> Result<Arc<Photographer>> {
        Ok(Arc::clone(&self.seat(name)?.photographer))
    }

    /// True values of the sample in the holder.
    pub fn expectation(&self) -> Expectation<'_> {
        Expectation::new(&self.stage.objects[0], self.stage.file.lamp.beam_half_angle_deg)
    }

    /// Spectral weight of a reading of `channel` (0, 1, 2 = R, G, B) of camera `name` behind `slot`: (nm, weight).
    pub fn band_weight(&self, name: &str, channel: usize, slot: u8) -> Result<Vec<(f64, f64)>> {
        let weight = self.seat(name)?.photographer.weight(slot, channel);
        let weight = weight.ok_or_else(|| SimError::Unknown {
            what: "lit slot and channel",
            name: format!("slot {slot}, channel {channel}"),
            known: format!("light in slots {:?}", self.stage.beams.keys().collect::<Vec<_>>()),
        })?;
        Ok(weight.0.iter().enumerate().map(|(i, w)| (wavelength_nm(i), *w)).collect())
    }

    /// The lamp's slow factor `seconds` after opening.
    pub fn lamp_factor(&self, seconds: f64) -> f64 {
        self.surroundings.lamp.slow(seconds)
    }

    /// The clock the bench lives by.
    #[cfg(test)]
    pub fn surroundings_clock(&self) -> Clock {
        self.surroundings.clock
    }

    fn seat(&self, name: &str) -> Result<&Seat> {
        self.cameras.get(name).ok_or_else(|| SimError::Unknown {
            what: "camera",
            name: name.to_owned(),
            known: self.cameras.keys().cloned().collect::<Vec<_>>().join(", "),
        })
    }
}
