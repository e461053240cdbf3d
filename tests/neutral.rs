//! Promise: on the noise-free bench a neutral sample is neutral to 1e-9: every band and every total gives the same
//! BSDF in every patch, whatever the filters, the channels and the response curve in between.
#![allow(clippy::unwrap_used, clippy::expect_used)]

mod common;

use goniod::engine::bsdf::budget::PatchBsdf;
use goniod::engine::bsdf::normalise::{RatioTerms, ratio};
use goniod::engine::bsdf::patches::ViewPatches;
use goniod::engine::bsdf::totals::combine;
use goniod::engine::optics::basis::AngleBasis;
use goniod::engine::optics::ellipsoid::Ellipsoid;
use goniod::engine::optics::fisheye::Fisheye;
use goniod::engine::optics::pixel_map::{Mosaic, PixelMap, PixelMapSpec};
use goniod::engine::radiometry::dark::Dark;
use goniod::engine::radiometry::levels::{LevelTable, Noise, Radiometer};
use goniod::engine::radiometry::merge::{Exposure, merge};
use goniod::engine::radiometry::response::{LevelConvention, Response};
use goniod::engine::spectra::combine::{Combiner, Prior};
use goniod::engine::spectra::curve::{Curve, Grid};
use goniod::engine::spectra::kernels::Kernel;
use goniod::engine::spectra::targets;
use goniod_drivers::clock::Clock;
use goniod_sim::bench::Bench;
use goniod_sim::pose::{Pose, PoseSource};
use goniod_sim::truth::config::BenchFile;
use goniod_sim::truth::photo;
use std::sync::Arc;

/// Integration times of every bracket: up to the dimmest pixel, which sees the sample at the edge of its lit part.
const TIMES_S: [f64; 10] = [0.05, 0.4, 3.2, 25.6, 2e2, 1.6e3, 1.3e4, 1e5, 8e5, 6e6];
/// Incident polar angle of the sample, degrees.
const THETA_DEG: f64 = 30.0;

struct Still;

impl PoseSource for Still {
    fn pose(&self, _: tokio::time::Instant) -> Pose {
        pose(180.0, 0.0, 1)
    }
}

fn pose(tilt_deg: f64, changer_deg: f64, slot: u8) -> Pose {
    Pose { tilt_deg, spin_deg: 180.0, changer_deg, slot: Some(slot), shutter_open: true }
}

/// The shipped bench without noise, dark, drift, deviations and point spread, with a camera of a sixteenth of the pixels.
fn ideal_bench(sample: &str) -> Bench {
    let path = common::root().join("config/sim/bench.toml");
    let mut file = BenchFile::read(&path).unwrap();
    file.idealise();
    let ccd = file.camera.get_mut("ccd").unwrap();
    (ccd.width_px, ccd.height_px) = (352, 272);
    (ccd.fisheye.centre_x_px, ccd.fisheye.centre_y_px, ccd.fisheye.deg_per_px) = (175.5, 143.5, 0.7544);
    let sample = common::root().join("config/sim/samples").join(sample);
    let clock = Clock::starting_at(goniod_drivers::clock::UtcMicros(0));
    Bench::assemble(file, &path, &sample, 1, Arc::new(Still), clock).unwrap()
}

fn map() -> PixelMap {
    PixelMap::build(&PixelMapSpec {
        width: 352,
        height: 272,
        reserved_rows: 16,
        mosaic: Mosaic::BayerRggb,
        fisheye: Fisheye { centre_x_px: 175.5, centre_y_px: 143.5, deg_per_px: 0.7544, roll_deg: 0.0 },
        ellipsoid: Ellipsoid::new(0.3).unwrap(),
        basis: AngleBasis::klems_full(),
        flipped: false,
        direction_u_deg: 0.1,
        blur_px: 0.0,
        vignetting: vec![-0.10, -0.05],
    })
    .unwrap()
}

/// A bracket of exact NDL, merged.
fn view(bench: &Bench, map: &PixelMap, table: &LevelTable, pose: Pose) -> ViewPatches {
    let photographer = bench.photographer("ccd").unwrap();
    let frames: Vec<Vec<f64>> = TIMES_S
        .iter()
        .map(|&seconds| photographer.ideal_ndl(&photo::Exposure { poses: vec![(1.0, pose)], seconds, lamp: 1.0 }))
        .collect();
    let exposures: Vec<Exposure<'_, f64>> =
        TIMES_S.iter().zip(&frames).map(|(&t_s, pixels)| Exposure { t_s, pixels }).collect();
    merge(map, table, &Dark::none(), &exposures).unwrap()
}

fn table() -> LevelTable {
    LevelTable::of(Radiometer {
        response: Response::paper(),
        convention: LevelConvention::BinCentre,
        levels: 256,
        noise: Noise { electrons_at_unit_exposure: 1767.5, read_noise_e: 10.0 },
        residual_ndl: 0.001,
    })
    .unwrap()
}

/// All 24 readings of a sample over the transmitting diffuser, band by band, channel by channel.
fn readings(bench: &Bench) -> Vec<Vec<PatchBsdf>> {
    let (map, table) = (map(), table());
    let terms = RatioTerms {
        reference_bsdf: 0.5 / std::f64::consts::PI,
        reference_relative_u: 0.003,
        reference_theta: 0.0,
        theta: THETA_DEG.to_radians(),
        theta_u: 0.0,
        drift_relative_u: 0.001,
    };
    let mut readings = Vec::new();
    for slot in 1..=8u8 {
        let reference = view(bench, &map, &table, pose(180.0, 270.0, slot));
        let sample = view(bench, &map, &table, pose(180.0 - THETA_DEG, 0.0, slot));
        for channel in 0..3 {
            readings.push(ratio(&sample.channels[channel], &reference.channels[channel], &terms).unwrap());
        }
    }
    readings
}

#[tokio::test]
async fn a_neutral_sample_is_neutral_to_1e_9() {
    let bench = ideal_bench("lambertian_t20.toml");
    let (readings, grid) = (readings(&bench), Grid::engine());
    let kernels: Vec<Kernel> = (0..24).map(|k| kernel(&bench, &grid, k / 3 + 1, usize::from(k % 3))).collect();
    let lists: Vec<&[PatchBsdf]> = readings.iter().map(Vec::as_slice).collect();
    let total = targets::radiometric(&grid, &vec![1.0; grid.len], [380.0, 945.0]);
    let combiner = Combiner::new(&grid, &kernels.iter().collect::<Vec<_>>(), &total, Prior::default()).unwrap();
    let totals = combine(&combiner, &lists).unwrap();
    let wanted = 0.2 / std::f64::consts::PI;
    for (patch, total) in totals.iter().enumerate() {
        for (k, reading) in readings.iter().enumerate() {
            let off = reading[patch].bsdf / wanted - 1.0;
            assert!(off.abs() < 1e-9, "patch {patch}, reading {k}: {off:e}");
        }
        assert!((total.bsdf / wanted - 1.0).abs() < 1e-9, "patch {patch}: total {}", total.bsdf);
        assert!(total.budget.spectral < 1e-9 * wanted, "nothing is unsure about a flat spectrum");
    }
}

/// With structure the colours of the mosaic see different places of it, but the bands of one colour stay equal.
#[tokio::test]
async fn every_band_of_a_colour_sees_the_same_structure_to_1e_9() {
    let readings = readings(&ideal_bench("neutral_grey.toml"));
    for channel in 0..3 {
        for (patch, first) in readings[channel].iter().enumerate() {
            for band in 1..8 {
                let off = readings[3 * band + channel][patch].bsdf / first.bsdf - 1.0;
                assert!(off.abs() < 1e-9, "channel {channel}, patch {patch}, band {band}: {off:e}");
            }
        }
    }
}

/// Kernel from the bench's own weights; for a neutral sample its shape cannot matter.
fn kernel(bench: &Bench, grid: &Grid, slot: u8, channel: usize) -> Kernel {
    let weight = bench.band_weight("ccd", channel, slot).unwrap();
    let curve = Curve::new(weight.iter().map(|w| w.0).collect(), weight.iter().map(|w| w.1).collect()).unwrap();
    let ones = vec![1.0; grid.len];
    Kernel::of(grid, &slot.to_string(), channel, [&grid.sample(&curve), &ones, &ones, &ones]).unwrap()
}
