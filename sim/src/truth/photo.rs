//! Photographs: exposure of every pixel of one camera for the true pose, then noise, response and levels.
//!
//! Exposure of channel k at a pixel: x = t E cos(theta_i) factor sum_c g_c(u) K(c, k, slot), with
//! K = int e F rho_m S_c r_k dlambda over 300-1700 nm, e the lamp's spectrum normalised to one.

use super::config::{BenchFile, CameraFile};
use super::draw::{CameraDraw, reference_factors};
use super::error::Result;
use super::mirror::Collector;
use super::raster::{Field, Raster};
use super::response::Sensor;
use super::rng::Key;
use super::sample::Sample;
use super::spectrum::{Curve, Outside, Table, stack};
use super::vector::{Side, V3, source_in_camera_frame};
use crate::pose::Pose;
use goniod_drivers::frame::{PixelFormat, Pixels};
use rayon::prelude::*;
use std::collections::{BTreeMap, VecDeque};
use std::path::Path;
use std::sync::{Arc, Mutex, OnceLock};

/// What stands before the cameras and what lights it: shared by all cameras of a bench.
#[derive(Debug)]
pub struct Stage {
    /// The bench file.
    pub file: BenchFile,
    /// Sample, reflecting diffuser, transmitting diffuser.
    pub objects: [Sample; 3],
    /// Lamp times filter stack by slot, normalised so that the open lamp integrates to one; no entry: no light.
    pub beams: BTreeMap<u8, Curve>,
    /// Mirror reflectance.
    pub mirror: Curve,
}

/// One exposure: what the pixels gather.
#[derive(Debug, Clone)]
pub struct Exposure {
    /// Poses during the exposure with their share of the time (sum 1).
    pub poses: Vec<(f64, Pose)>,
    /// Integration time.
    pub seconds: f64,
    /// The lamp's factor during it.
    pub lamp: f64,
}

/// Light of one channel set on the pixels.
type Channels = [f64; 3];

/// One camera with everything that is computed once.
#[derive(Debug)]
pub struct Photographer {
    stage: Arc<Stage>,
    /// The camera's file entry.
    pub file: CameraFile,
    /// Response and noise.
    pub sensor: Sensor,
    /// Responsivity as built, one curve a channel.
    pub responsivity: Vec<Curve>,
    collector: Collector,
    raster: OnceLock<Raster>,
    scenes: Mutex<VecDeque<(SceneKey, Arc<Scene>)>>,
    noise: Key,
}

/// Object before the camera.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Object {
    index: usize,
    turned: bool,
}

/// Identity of a scene: object and holder angles by their bits.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct SceneKey {
    object: Object,
    angles: [u64; 2],
}

/// Fields of one pose.
#[derive(Debug)]
struct Scene {
    cos_i: f64,
    fields: Vec<(usize, Field)>,
}

/// Fields with their weights for one exposure.
#[derive(Default)]
struct Mix {
    uniform: Channels,
    scenes: Vec<(Arc<Scene>, usize, Channels)>,
    dark: f64,
}

/// Scenes kept; one exposure of a moving holder may need several.
const SCENES: usize = 3;

// === impl Stage ===

impl Stage {
    /// Reads lamp, glasses, mirror and diffusers named by `file` (of `path`).
    pub fn new(file: BenchFile, path: &Path, sample: Sample, seed: u64) -> Result<Stage> {
        let lamp = file.lamp.spectrum.load(path, Outside::Refuse)?;
        let lamp = lamp.scaled(1.0 / lamp.integral());
        let folder = |p: &Path| super::error::beside(path, p);
        let glasses = Table::read(&folder(&file.wheel.glasses))?;
        let mut beams = BTreeMap::new();
        for (key, slot) in file.wheel.slot.iter().filter(|(_, s)| !s.blank) {
            let list: Vec<(String, f64)> = slot.glasses.iter().map(|g| (g.glass.clone(), g.thickness_mm)).collect();
            let filter = stack(&glasses, &folder(&file.wheel.glass_parameters), &list)?;
            beams.extend(key.parse().ok().map(|n: u8| (n, lamp.times(&filter))));
        }
        let factors = reference_factors(&file, seed);
        let reflecting = file.reference.reflection.load(path, Outside::Refuse)?.scaled(factors[0]);
        let transmitting = file.reference.transmission.load(path, Outside::Refuse)?.scaled(factors[1]);
        let reflection = [Side::ReflectionFront, Side::ReflectionBack];
        let transmission = [Side::TransmissionFront, Side::TransmissionBack];
        let objects = [
            sample,
            Sample::diffuser("reflecting diffuser", &reflection, reflecting),
            Sample::diffuser("transmitting diffuser", &transmission, transmitting),
        ];
        let mirror = file.mirror.reflectance.load(path, Outside::Refuse)?;
        Ok(Stage { file, objects, beams, mirror })
    }

    /// What the changer presents.
    fn object(&self, changer_deg: f64) -> Option<Object> {
        let h = &self.file.holder;
        let places = [
            (h.sample_deg, Object { index: 0, turned: false }),
            (h.sample_flipped_deg, Object { index: 0, turned: true }),
            (h.reflection_reference_deg, Object { index: 1, turned: false }),
            (h.transmission_reference_deg, Object { index: 2, turned: false }),
        ];
        places.into_iter().find(|(at, _)| (changer_deg - at).abs() <= h.tolerance_deg).map(|(_, object)| object)
    }
}

// === impl Photographer ===

impl Photographer {
    /// The camera `name` of the stage, read relative to the bench file `path`.
    pub fn new(stage: Arc<Stage>, path: &Path, name: &str, seed: u64) -> Result<Photographer> {
        let Some(file) = stage.file.camera.get(name).cloned() else {
            let known = stage.file.camera.keys().cloned().collect::<Vec<_>>().join(", ");
            return Err(super::error::SimError::Unknown { what: "camera", name: name.to_owned(), known });
        };
        let draw = CameraDraw::new(&stage.file.deviation, seed, name);
        let table = Table::read(&super::error::beside(path, &file.responsivity))?;
        let curve = |c: &String| Ok(table.curve(Some(c), Outside::Zero)?.scaled(draw.responsivity));
        let responsivity = file.channels.iter().map(curve).collect::<Result<Vec<_>>>()?;
        let radius = stage.file.holder.sample_radius_mm;
        Ok(Photographer {
            sensor: Sensor::new(&file, draw, stage.file.ideal),
            collector: Collector::new(stage.file.mirror.shape, &file.fisheye, radius, draw),
            responsivity,
            raster: OnceLock::new(),
            scenes: Mutex::default(),
            noise: Key::new(seed).named("pixel").named(name),
            file,
            stage,
        })
    }

    /// What the pixels see, traced at first use.
    pub fn raster(&self) -> &Raster {
        let (file, lens) = (&self.file, &self.file.fisheye);
        self.raster.get_or_init(|| Raster::new(&self.collector, file.width_px, file.height_px, lens.reserved_rows))
    }

    /// Channel of a pixel: 0, 1, 2 = R, G, B of the mosaic; 0 without mosaic.
    pub fn channel(&self, row: usize, column: usize) -> usize {
        if self.file.format == PixelFormat::BayerRggb8 { (row & 1) + (column & 1) } else { 0 }
    }

    /// Spectral weight of a reading of `channel` behind `slot`, on the grid: e F rho_m r_k; `None` for a blank.
    pub fn weight(&self, slot: u8, channel: usize) -> Option<Curve> {
        let beam = self.stage.beams.get(&slot)?;
        Some(beam.times(&self.stage.mirror).times(self.responsivity.get(channel)?))
    }

    /// Exposure of every pixel without noise; reserved rows are 0.
    pub fn exposures(&self, exposure: &Exposure) -> Vec<f64> {
        let mix = self.mix(exposure);
        let width = self.file.width_px;
        let mut x = vec![0.0; width * self.file.height_px];
        let reserved = self.file.fisheye.reserved_rows;
        x.par_chunks_mut(width).enumerate().skip(reserved).for_each(|(row, out)| self.row(&mix, row, out));
        x
    }

    /// NDL of every pixel without noise and quantisation.
    pub fn ideal_ndl(&self, exposure: &Exposure) -> Vec<f64> {
        self.exposures(exposure).into_iter().map(|x| self.sensor.ndl(x)).collect()
    }

    /// A photograph: levels of all pixels; `buffer` is used again where it fits. `frame` keys the noise.
    pub fn photograph(&self, exposure: &Exposure, frame: u64, buffer: Option<Pixels>) -> Pixels {
        let mix = self.mix(exposure);
        let n = self.file.width_px * self.file.height_px;
        match (buffer, self.file.levels() <= 256) {
            (Some(Pixels::U8(mut v)), true) => {
                v.resize(n, 0);
                self.fill(&mix, frame, &mut v, |level| level as u8);
                Pixels::U8(v)
            }
            (_, true) => self.photograph(exposure, frame, Some(Pixels::U8(Vec::new()))),
            (Some(Pixels::U16(mut v)), false) => {
                v.resize(n, 0);
                self.fill(&mix, frame, &mut v, |level| level);
                Pixels::U16(v)
            }
            (_, false) => self.photograph(exposure, frame, Some(Pixels::U16(Vec::new()))),
        }
    }

    fn fill<T: Copy + Send + Default>(&self, mix: &Mix, frame: u64, out: &mut [T], narrow: impl Fn(u16) -> T + Sync) {
        let (width, reserved) = (self.file.width_px, self.file.fisheye.reserved_rows);
        let key = self.noise.with(frame);
        out.par_chunks_mut(width).enumerate().for_each_init(
            || vec![0.0; width],
            |x, (row, levels)| {
                if row < reserved {
                    levels.fill(T::default());
                    return;
                }
                self.row(mix, row, x);
                self.sensor.expose_row(x, key, row * width, |i, level| levels[i] = narrow(level));
            },
        );
    }

    /// Exposures of one row.
    fn row(&self, mix: &Mix, row: usize, x: &mut [f64]) {
        let (raster, first) = (self.raster(), row * self.file.width_px);
        let factors = &raster.factor[first..first + x.len()];
        let pair = |c: &Channels| [c[self.channel(row, 0)], c[self.channel(row, 1)]];
        let uniform = pair(&mix.uniform);
        for (i, (x, f)) in x.iter_mut().zip(factors).enumerate() {
            *x = mix.dark + f64::from(*f) * uniform[i & 1];
        }
        for (scene, place, channels) in &mix.scenes {
            let k = pair(channels);
            match scene.fields.get(*place).map(|f| &f.1) {
                Some(Field::Dense(values)) => {
                    let values = &values[first..first + x.len()];
                    for (i, ((x, f), g)) in x.iter_mut().zip(factors).zip(values).enumerate() {
                        *x += f64::from(f * g) * k[i & 1];
                    }
                }
                Some(Field::Sparse(lit)) => {
                    let from = lit.partition_point(|(i, _)| (*i as usize) < first);
                    let end = first + x.len();
                    for (index, g) in lit[from..].iter().take_while(|(i, _)| (*i as usize) < end) {
                        let i = *index as usize - first;
                        x[i] += f64::from(factors[i]) * g * k[i & 1];
                    }
                }
                Some(Field::Uniform(_)) | None => {}
            }
        }
    }

    /// Adds up what the poses of an exposure give.
    fn mix(&self, exposure: &Exposure) -> Mix {
        let mut mix = Mix { dark: self.sensor.dark_per_s * exposure.seconds, ..Mix::default() };
        for (share, pose) in &exposure.poses {
            let Some((object, weights)) = self.light(pose) else { continue };
            let scene = self.scene(object, pose);
            let light = self.stage.file.lamp.irradiance_uw_per_cm2 * scene.cos_i;
            let common = light * share * exposure.seconds * exposure.lamp;
            for (place, (component, field)) in scene.fields.iter().enumerate() {
                let Some(k) = weights.get(*component) else { continue };
                let k = k.map(|k| k * common);
                match field {
                    Field::Uniform(g) => (0..3).for_each(|c| mix.uniform[c] += g * k[c]),
                    _ => mix.scenes.push((Arc::clone(&scene), place, k)),
                }
            }
        }
        mix
    }

    /// Object and K of its components by channel; `None` in the dark.
    fn light(&self, pose: &Pose) -> Option<(Object, Vec<Channels>)> {
        let slot = pose.slot.filter(|_| pose.shutter_open)?;
        let object = self.stage.object(pose.changer_deg)?;
        let components = &self.stage.objects[object.index].components;
        let mut weights = vec![[0.0; 3]; components.len()];
        for channel in 0..self.responsivity.len().min(3) {
            let weight = self.weight(slot, channel)?;
            for (k, component) in weights.iter_mut().zip(components) {
                k[channel] = weight.times(&component.spectrum).integral();
            }
        }
        Some((object, weights))
    }

    /// Fields of a pose, kept for the next exposures.
    fn scene(&self, object: Object, pose: &Pose) -> Arc<Scene> {
        let key = SceneKey { object, angles: [pose.tilt_deg.to_bits(), pose.spin_deg.to_bits()] };
        if let Ok(kept) = self.scenes.lock()
            && let Some((_, scene)) = kept.iter().find(|(k, _)| *k == key)
        {
            return Arc::clone(scene);
        }
        let scene = Arc::new(self.make_scene(object, pose));
        if let Ok(mut kept) = self.scenes.lock() {
            kept.push_front((key, Arc::clone(&scene)));
            kept.truncate(SCENES);
        }
        scene
    }

    fn make_scene(&self, object: Object, pose: &Pose) -> Scene {
        let holder = &self.stage.file.holder;
        let s = source_in_camera_frame(pose.tilt_deg - holder.tilt_zero_deg, pose.spin_deg - holder.spin_zero_deg);
        let towards_camera = V3::new(0.0, 0.0, 1.0);
        let own = |v: V3| if object.turned { v.turned() } else { v };
        let side = Side::of(own(s), own(towards_camera));
        let half_angle = self.stage.file.lamp.beam_half_angle_deg.to_radians();
        let components = self.stage.objects[object.index].components.iter().enumerate();
        let fields = components
            .filter(|(_, c)| c.sides.contains(&side))
            .filter_map(|(i, c)| {
                let emission = c.law.emission(side, own(s), half_angle)?;
                Some((i, self.raster().field(&self.collector, &emission, object.turned)))
            })
            .collect();
        Scene { cos_i: s.z.abs(), fields }
    }
}
