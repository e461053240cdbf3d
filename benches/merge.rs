//! The fused bracket merge against a plain one, in the same process: prints their ratio. The plain one does what a
//! script would: linearise every frame into an image of its own, then average the images.
#![allow(missing_docs, clippy::unwrap_used, clippy::print_stdout)]

use goniod::engine::optics::basis::AngleBasis;
use goniod::engine::optics::ellipsoid::Ellipsoid;
use goniod::engine::optics::fisheye::Fisheye;
use goniod::engine::optics::pixel_map::{Mosaic, PixelMap, PixelMapSpec};
use goniod::engine::radiometry::dark::Dark;
use goniod::engine::radiometry::levels::{LevelTable, Noise, Radiometer};
use goniod::engine::radiometry::merge::{Exposure, merge};
use goniod::engine::radiometry::response::{LevelConvention, Response};
use goniod_drivers::clock::Clock;
use std::hint::black_box;

const TIMES_S: [f64; 5] = [0.01, 0.04, 0.16, 0.64, 2.56];
const W: usize = 1392;
const H: usize = 1040;
const ROUNDS: usize = 10;

#[tokio::main(flavor = "current_thread")]
async fn main() {
    let clock = Clock::system();
    let map = map();
    let radiometer = Radiometer {
        response: Response::paper(),
        convention: LevelConvention::BinCentre,
        levels: 256,
        noise: Noise { electrons_at_unit_exposure: 1767.5, read_noise_e: 10.0 },
        residual_ndl: 0.001,
    };
    let table = LevelTable::of(radiometer).unwrap();
    let response = radiometer.response;
    let frame = |t: &f64| -> Vec<u8> {
        (0..W * H).map(|i| (256.0 * response.ndl((1.0 + (i % 89) as f64 / 20.0) * t)) as u8).collect()
    };
    let frames: Vec<Vec<u8>> = TIMES_S.iter().map(frame).collect();
    let exposures: Vec<Exposure<'_, u8>> =
        TIMES_S.iter().zip(&frames).map(|(&t_s, pixels)| Exposure { t_s, pixels }).collect();
    let mut ratios: Vec<f64> = (0..ROUNDS)
        .map(|_| {
            let start = clock.elapsed();
            black_box(merge(&map, &table, &Dark::none(), &exposures).unwrap());
            let middle = clock.elapsed();
            black_box(plain(&response, &frames));
            (clock.elapsed() - middle).as_secs_f64() / (middle - start).as_secs_f64()
        })
        .collect();
    ratios.sort_by(f64::total_cmp);
    let (median, least, most) = (ratios[ROUNDS / 2], ratios[0], ratios[ROUNDS - 1]);
    println!("{W} x {H}, five exposures, plain / fused: median {median:.1}, min {least:.1}, max {most:.1}");
}

fn map() -> PixelMap {
    PixelMap::build(&PixelMapSpec {
        width: W,
        height: H,
        reserved_rows: 16,
        mosaic: Mosaic::BayerRggb,
        fisheye: Fisheye { centre_x_px: 695.5, centre_y_px: 527.5, deg_per_px: 0.1886, roll_deg: 0.0 },
        ellipsoid: Ellipsoid::new(0.3).unwrap(),
        basis: AngleBasis::klems_full(),
        flipped: false,
        direction_u_deg: 0.1,
        blur_px: 1.0,
        vignetting: vec![-0.1, -0.05],
    })
    .unwrap()
}

/// Linearises with the closed form pixel by pixel and averages over the exposures that are not at an end.
fn plain(response: &Response, frames: &[Vec<u8>]) -> f64 {
    let images: Vec<Vec<f64>> = frames
        .iter()
        .zip(TIMES_S)
        .map(|(f, t)| f.iter().map(|&level| response.exposure((f64::from(level) + 0.5) / 256.0) / t).collect())
        .collect();
    let mean = |i: usize| {
        let good = images.iter().zip(frames).filter(|(_, f)| (1..255).contains(&f[i]));
        let (sum, n) = good.fold((0.0, 0.0), |(s, n), (image, _)| (s + image[i], n + 1.0));
        if n > 0.0 { sum / n } else { 0.0 }
    };
    (0..W * H).map(mean).sum()
}
