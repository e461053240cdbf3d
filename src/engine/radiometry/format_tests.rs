//! One coloured scene in every order of the mosaic, every depth of levels and as sums: the same radiance comes back.
#![allow(clippy::unwrap_used, clippy::expect_used)]

use super::dark::Dark;
use super::levels::tests::{ccd, ingaas};
use super::levels::{LevelTable, Radiometer, Reading};
use super::merge::{Exposure, merge};
use super::sums::SumLevel;
use crate::optics::pixel_map::{Mosaic, PixelMap, PixelMapSpec, tests as maps, vignetting};

const TIMES: [f64; 5] = [0.01, 0.04, 0.16, 0.64, 2.56];
/// Exposure rates of the scene in red, green and blue; a mono sensor sees the first.
const RATES: [f64; 3] = [9.0, 3.0, 1.0];
const ORDERS: [Mosaic; 4] = [Mosaic::BayerRggb, Mosaic::BayerGrbg, Mosaic::BayerGbrg, Mosaic::BayerBggr];

/// Where the colours of the first two rows lie, written out: 0, 1, 2 = red, green, blue.
fn colour(mosaic: Mosaic, row: usize, column: usize) -> usize {
    let rows = match mosaic {
        Mosaic::BayerRggb => [[0, 1], [1, 2]],
        Mosaic::BayerGrbg => [[1, 0], [2, 1]],
        Mosaic::BayerGbrg => [[1, 2], [0, 1]],
        Mosaic::BayerBggr => [[2, 1], [1, 0]],
        Mosaic::Mono => [[0, 0], [0, 0]],
    };
    rows[row % 2][column % 2]
}

/// A photograph of `t` seconds.
fn photograph(spec: &PixelMapSpec, r: &Radiometer, t: f64, seed: &mut u64) -> Vec<u16> {
    let mut uniform = || {
        *seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        ((*seed >> 11) as f64 + 0.5) / (1_u64 << 53) as f64
    };
    let mut level = |i: usize| {
        let (row, column) = (i / spec.width, i % spec.width);
        let zenith = spec.fisheye.zenith_deg(column as f64, row as f64);
        let x = RATES[colour(spec.mosaic, row, column)] * t * vignetting(&spec.vignetting, (zenith / 90.0).min(1.0));
        let e1 = r.noise.electrons_at_unit_exposure;
        let normal = (-2.0 * uniform().ln()).sqrt() * (std::f64::consts::TAU * uniform()).cos();
        let electrons = x * e1 + normal * (x * e1 + r.noise.read_noise_e.powi(2)).sqrt();
        let level = (f64::from(r.levels) * r.response.ndl((electrons / e1).max(0.0))).floor();
        level.clamp(0.0, f64::from(r.levels - 1)) as u16
    };
    (0..spec.width * spec.height).map(&mut level).collect()
}

/// Every channel must have its rate: the mean within 0.3 %, the patches as far from it as they say.
fn the_scene_comes_back<P: Reading>(spec: &PixelMapSpec, r: Radiometer, exposures: &[Exposure<'_, P>], what: &str) {
    let map = PixelMap::build(spec).unwrap();
    let view = merge(&map, &LevelTable::of(r).unwrap(), &Dark::none(), exposures).unwrap();
    assert_eq!(view.channels.len(), if spec.mosaic == Mosaic::Mono { 1 } else { 3 });
    for (channel, rate) in view.channels.iter().zip(RATES) {
        let n = channel.len() as f64;
        let mean = channel.iter().map(|p| p.rate).sum::<f64>() / n;
        let chi2 = channel.iter().map(|p| ((p.rate - rate) / p.u_random).powi(2)).sum::<f64>() / n;
        assert!((mean / rate - 1.0).abs() < 3e-3, "{what}: {mean} instead of {rate}");
        assert!((0.5..1.7).contains(&chi2), "{what}: chi2 {chi2}");
    }
}

fn eight_or_sixteen_bits(spec: &PixelMapSpec, r: Radiometer, seed: &mut u64, what: &str) {
    let frames: Vec<Vec<u16>> = TIMES.iter().map(|t| photograph(spec, &r, *t, seed)).collect();
    if r.levels > 256 {
        let exposures: Vec<Exposure<'_, u16>> =
            TIMES.iter().zip(&frames).map(|(t, f)| Exposure { t_s: *t, pixels: &f[..] }).collect();
        return the_scene_comes_back(spec, r, &exposures, what);
    }
    let bytes: Vec<Vec<u8>> = frames.iter().map(|f| f.iter().map(|l| u8::try_from(*l).unwrap()).collect()).collect();
    let exposures: Vec<Exposure<'_, u8>> =
        TIMES.iter().zip(&bytes).map(|(t, f)| Exposure { t_s: *t, pixels: &f[..] }).collect();
    the_scene_comes_back(spec, r, &exposures, what);
}

#[test]
fn every_order_of_the_mosaic_and_every_depth_gives_the_same_radiance() {
    let mut seed = 41;
    for mosaic in ORDERS {
        for bits in [8, 10, 12, 16] {
            let r = Radiometer { levels: 1 << bits, ..ccd() };
            eight_or_sixteen_bits(&maps::small(mosaic), r, &mut seed, &format!("{mosaic:?}, {bits} bits"));
        }
    }
    for bits in [8, 10, 12, 14, 16] {
        let r = Radiometer { levels: 1 << bits, ..ingaas() };
        eight_or_sixteen_bits(&maps::small(Mosaic::Mono), r, &mut seed, &format!("mono, {bits} bits"));
    }
}

/// The longest time as the sum of four, beside single shorter ones.
#[test]
fn a_bracket_with_sums_gives_the_same_radiance() {
    let mut seed = 43;
    for (mosaic, bits) in [(Mosaic::BayerBggr, 8), (Mosaic::Mono, 12)] {
        let (spec, r) = (maps::small(mosaic), Radiometer { levels: 1 << bits, ..ccd() });
        let frames: Vec<Vec<SumLevel>> = TIMES
            .iter()
            .map(|t| {
                let exposures = if *t > 1.0 { 4 } else { 1 };
                let mut sum = vec![SumLevel { level: 0, exposures }; spec.width * spec.height];
                for _ in 0..exposures {
                    let one = photograph(&spec, &r, t / f64::from(exposures), &mut seed);
                    sum.iter_mut().zip(one).for_each(|(s, l)| s.level += l);
                }
                sum
            })
            .collect();
        let t_s = |f: &[SumLevel], t: f64| t / f64::from(f[0].exposures);
        let exposures: Vec<Exposure<'_, SumLevel>> =
            TIMES.iter().zip(&frames).map(|(t, f)| Exposure { t_s: t_s(f, *t), pixels: &f[..] }).collect();
        the_scene_comes_back(&spec, r, &exposures, &format!("{mosaic:?}, sums"));
    }
}
