//! Photographs against physics: integrals over the hemisphere with a quadrature of their own, known values of the
//! shipped samples, noise, cost.
#![allow(clippy::unwrap_used, clippy::expect_used)]

use super::config::BenchFile;
use super::expect::{Expectation, Incidence, Patch};
use super::photo::Photographer;
use super::sample::Sample;
use super::spectrum::Curve;
use super::test_bench::{file, path, photographer, still};
use super::vector::{Side, V3};
use goniod_drivers::frame::Pixels;

/// An ideal bench with a plain lens: no vignetting, pupil at F2.
fn plain() -> BenchFile {
    let mut file = file(true);
    for camera in file.camera.values_mut() {
        camera.fisheye.vignetting.clear();
        camera.fisheye.pupil_walk_mm.clear();
    }
    file
}

/// Axis angles (tilt, spin, changer) for a side and an incidence told in the sample frame.
fn pose(side: Side, theta: f64, phi: f64) -> (f64, f64, f64) {
    let turned = matches!(side, Side::ReflectionFront | Side::TransmissionBack);
    // Turned about y, x changes its sign: azimuth phi becomes 180 - phi.
    let spin = if turned { 180.0 - phi } else { phi };
    let tilt = if side.is_transmission() { 180.0 - theta } else { theta };
    (tilt, spin.rem_euclid(360.0), if turned { 180.0 } else { 0.0 })
}

/// sum BSDF cos dO_sample over the pixels, with dO_sample = k^2 sin(t)/t (1-E^2)/(1+E v_x)^2 and
/// BSDF = x / (t E cos(theta_i) int e F rho r).
fn integral(camera: &Photographer, bench: &BenchFile, angles: (f64, f64, f64), slot: u8) -> f64 {
    let (tilt, spin, changer) = angles;
    let seconds = 0.25;
    let x = camera.exposures(&still(tilt, spin, changer, slot, seconds));
    let (file, lens) = (&camera.file, &camera.file.fisheye);
    let k = lens.deg_per_px.to_radians();
    let big = 2.0 * 0.3 / 1.09;
    let white: Vec<f64> =
        (0..camera.responsivity.len()).map(|c| camera.weight(slot, c).map_or(0.0, |w| w.integral())).collect();
    let light = bench.lamp.irradiance_uw_per_cm2 * tilt.to_radians().cos().abs() * seconds;
    let mut sum = 0.0;
    for (i, x) in x.iter().enumerate().filter(|(_, x)| **x > 0.0) {
        let (row, column) = (i / file.width_px, i % file.width_px);
        let (px, py) = (column as f64 - lens.centre_x_px, lens.centre_y_px - row as f64);
        let rho = px.hypot(py);
        let theta = k * rho;
        let vx = theta.sin() * px / rho;
        let solid = k * k * (theta.sin() / theta) * (1.0 - big * big) / (1.0 + big * vx).powi(2);
        let uz = theta.cos() * (1.0 - big * big).sqrt() / (1.0 + big * vx);
        sum += x / (light * white[camera.channel(row, column)]) * uz * solid;
    }
    sum
}

/// Spectral mean of a curve under the band's weight.
fn mean(curve: &Curve, camera: &Photographer, slot: u8) -> f64 {
    let weight = camera.weight(slot, 0).unwrap();
    weight.times(curve).integral() / weight.integral()
}

#[test]
fn photographs_of_every_shipped_sample_integrate_to_its_hemispherical_value() {
    let cases = [
        ("lambertian_t20", 1e-3),
        ("prism42", 4e-3),
        ("neutral_grey", 2e-3),
        ("rough_glass", 2e-3),
        ("lambspec_tree", 4e-3),
        ("coloured_diffuser", 1e-3),
        // The lamp's disc is smaller than a pixel, so this quadrature (not the picture) is coarse.
        ("clear_glazing", 2e-2),
    ];
    for (name, tolerance) in cases {
        let sample = Sample::read(&path(&format!("samples/{name}.toml"))).unwrap();
        let camera = photographer(plain(), name, "ingaas");
        for side in Side::ALL {
            for (theta, phi) in [(0.0, 180.0), (30.0, 180.0), (60.0, 75.0)] {
                let seen = integral(&camera, &plain(), pose(side, theta, phi), 9);
                let wanted = mean(&sample.hemispherical(side, theta, phi), &camera, 9);
                let message = format!("{name} {side:?} {theta} {phi}: {seen} {wanted}");
                assert!((seen - wanted).abs() < tolerance * wanted.max(0.2), "{message}");
            }
        }
    }
}

/// Transmittance of a sample in the middle of band f5.
fn mean_of(name: &str, theta: f64, phi: f64) -> f64 {
    let sample = Sample::read(&path(&format!("samples/{name}.toml"))).unwrap();
    sample.hemispherical(Side::TransmissionFront, theta, phi).at(590.0)
}

#[test]
fn the_ccd_sees_the_same_totals() {
    for (name, side, theta, phi, wanted) in [
        ("lambertian_t20", Side::TransmissionFront, 0.0, 0.0, 0.2),
        ("lambertian_t20", Side::ReflectionFront, 45.0, 10.0, 0.3),
        ("prism42", Side::TransmissionFront, 30.0, 180.0, 0.948),
        ("lambspec_tree", Side::TransmissionBack, 50.0, 200.0, 0.7),
        ("clear_glazing", Side::TransmissionFront, 40.0, 200.0, mean_of("clear_glazing", 40.0, 200.0)),
        ("clear_glazing", Side::TransmissionFront, 65.0, 330.0, mean_of("clear_glazing", 65.0, 330.0)),
    ] {
        let camera = photographer(plain(), name, "ccd");
        let seen = integral(&camera, &plain(), pose(side, theta, phi), 5);
        assert!((seen / wanted - 1.0).abs() < 3e-3, "{name} {side:?}: {seen} {wanted}");
    }
}

/// The numbers of the samples' provenance sheet (read back there with other programs).
#[test]
fn xml_samples_have_their_known_values() {
    let known = [
        ("prism42", Side::TransmissionFront, [0.954, 0.948, 0.464]),
        ("prism42", Side::ReflectionFront, [0.046, 0.052, 0.523]),
        ("lambspec_tree", Side::TransmissionFront, [0.7, 0.7, 0.7]),
        ("lambspec_tree", Side::TransmissionBack, [0.7, 0.7, 0.7]),
        ("lambspec_tree", Side::ReflectionFront, [0.1, 0.1, 0.1]),
        ("lambspec_tree", Side::ReflectionBack, [0.12, 0.12, 0.12]),
    ];
    for (name, side, values) in known {
        let sample = Sample::read(&path(&format!("samples/{name}.toml"))).unwrap();
        for (theta, value) in [0.0, 30.0, 60.0].into_iter().zip(values) {
            // Azimuth index 0 of the file = light travels along +x = source at 180 degrees.
            let found = sample.hemispherical(side, theta, 180.0).0[40];
            assert!((found - value).abs() < 1e-3, "{name} {side:?} {theta}: {found}");
        }
    }
}

/// Light at normal incidence leaves the prism into patches (20, 90) with 49 % and (30, 90) with 18 %, upwards in the
/// picture.
#[test]
fn the_prism_bends_upwards_in_file_and_picture() {
    let sample = Sample::read(&path("samples/prism42.toml")).unwrap();
    let truth = Expectation::new(&sample, 0.25);
    let incidence = Incidence { side: Side::TransmissionFront, theta_deg: 0.0, phi_deg: 0.0 };
    for (low, width, share) in [(15.0, 22.5, 0.49), (25.0, 18.0, 0.18)] {
        let patch = Patch { theta_low_deg: low, theta_high_deg: low + 10.0, phi_deg: 90.0, phi_width_deg: width };
        let found = truth.patch_mean(incidence, &patch, &[(550.0, 1.0)]) * patch.projected();
        assert!((found - share).abs() < 0.006, "{found}");
    }
    let camera = photographer(plain(), "prism42", "ingaas");
    let x = camera.exposures(&still(180.0, 0.0, 0.0, 9, 0.1));
    let brightest = (0..x.len()).max_by(|a, b| x[*a].total_cmp(&x[*b])).unwrap();
    let u = camera.raster().direction(brightest).unwrap();
    assert!(u.y > 0.25 && u.x.abs() < 0.15, "{u:?}");
}

#[test]
fn patch_means_of_all_laws_add_up_to_the_hemispherical_value() {
    for name in ["lambertian_t20", "neutral_grey", "clear_glazing", "lambspec_tree", "prism42"] {
        let sample = Sample::read(&path(&format!("samples/{name}.toml"))).unwrap();
        let truth = Expectation::new(&sample, 0.25);
        let incidence = Incidence { side: Side::TransmissionFront, theta_deg: 33.0, phi_deg: 140.0 };
        let weights = [(500.0, 1.0), (600.0, 2.0)];
        let mut sum = 0.0;
        for i in 0..9 {
            for k in 0..12 {
                let patch = Patch {
                    theta_low_deg: 10.0 * f64::from(i),
                    theta_high_deg: 10.0 * f64::from(i + 1),
                    phi_deg: 30.0 * f64::from(k),
                    phi_width_deg: 30.0,
                };
                sum += truth.patch_mean(incidence, &patch, &weights) * patch.projected();
            }
        }
        let total = truth.hemispherical(incidence, &weights);
        assert!((sum / total - 1.0).abs() < 5e-3, "{name}: {sum} {total}");
    }
}

/// Mean and variance of a Lambertian picture against shot + read noise.
#[test]
fn noise_is_shot_and_read_noise_in_electrons() {
    let mut bench = file(false);
    bench.deviation.vignetting = 0.0;
    let camera = photographer(bench, "lambertian_t20", "ingaas");
    let exposure = still(180.0, 0.0, 0.0, 9, 0.2);
    let x = camera.exposures(&exposure);
    let (a, b) = (camera.photograph(&exposure, 1, None), camera.photograph(&exposure, 2, None));
    assert_ne!(a, b);
    assert_eq!(a, camera.photograph(&exposure, 1, None));
    let (mut ratio, mut bias, mut n) = (0.0, 0.0, 0.0);
    for (i, x) in x.iter().enumerate().filter(|(_, x)| **x > 0.3) {
        let to_x = |p: &Pixels| (f64::from(p.level(i)) + 0.5) / 4096.0 / 0.3;
        let electrons = x * 240_000.0;
        let wanted = (electrons + 150.0f64.powi(2)) / 240_000.0f64.powi(2) + (1.0 / 4096.0 / 0.3f64).powi(2) / 12.0;
        ratio += 0.5 * (to_x(&a) - to_x(&b)).powi(2) / wanted;
        bias += (to_x(&a) - x) / wanted.sqrt();
        n += 1.0;
    }
    assert!(n > 10_000.0);
    // The response residual of this seed shifts the mean by less than its 0.001 NDL; noise alone by 0.01 sigma.
    assert!((ratio / n - 1.0).abs() < 0.03, "{}", ratio / n);
    assert!((bias / n).abs() < 1.5, "{}", bias / n);
}

#[test]
fn the_dark_slot_the_shutter_and_a_turning_wheel_give_no_light() {
    let camera = photographer(file(true), "lambertian_t20", "ingaas");
    let lit = still(180.0, 0.0, 0.0, 9, 0.1);
    assert!(camera.exposures(&lit).iter().any(|x| *x > 0.1));
    let mut dark = [lit.clone(), lit.clone(), lit.clone(), lit];
    dark[0].poses[0].1.slot = Some(12);
    dark[1].poses[0].1.slot = None;
    dark[2].poses[0].1.shutter_open = false;
    dark[3].poses[0].1.changer_deg = 45.0;
    for exposure in &dark {
        assert!(camera.exposures(exposure).iter().all(|x| *x == 0.0));
    }
}

/// The brightest pixel looks where the sample's own law is brightest, told in the sample frame, on all four sides.
#[test]
fn every_side_of_the_prism_lights_the_right_place_of_the_picture() {
    let camera = photographer(plain(), "prism42", "ccd");
    let sample = Sample::read(&path("samples/prism42.toml")).unwrap();
    for side in Side::ALL {
        let (tilt, spin, changer) = pose(side, 40.0, 250.0);
        let x = camera.exposures(&still(tilt, spin, changer, 5, 0.1));
        let red = |i: &usize| camera.channel(i / 1392, i % 1392) == 0;
        let brightest = (0..x.len()).filter(red).max_by(|a, b| x[*a].total_cmp(&x[*b])).unwrap();
        let u = camera.raster().direction(brightest).unwrap();
        let u = if changer == 180.0 { u.turned() } else { u };
        let source = side.source_vector(40.0, 250.0);
        assert_eq!(Side::of(source, u), side);
        let emission = sample.components[0].law.emission(side, source, 0.004).unwrap();
        let mut most: f64 = 0.0;
        for i in 0..90 {
            for k in 0..180 {
                let v = V3::polar(f64::from(i).to_radians(), f64::from(2 * k).to_radians());
                most = most.max(emission.at(V3::new(v.x, v.y, side.emergent_sign() * v.z)));
            }
        }
        assert!(emission.at(u) > 0.999 * most, "{side:?}: {} {most}", emission.at(u));
    }
}

#[test]
fn the_references_stand_where_the_changer_says() {
    let camera = photographer(plain(), "prism42", "ingaas");
    let opal = integral(&camera, &plain(), (180.0, 0.0, 270.0), 9);
    let white = integral(&camera, &plain(), (8.0, 0.0, 90.0), 9);
    assert!((opal - 0.5).abs() < 1e-3, "{opal}");
    assert!((0.97..1.0).contains(&white), "{white}");
    assert_eq!(integral(&camera, &plain(), (8.0, 0.0, 270.0), 9), 0.0);
}

/// Half of the poses of an exposure dark: half the light.
#[test]
fn a_shutter_that_closes_in_mid_exposure_halves_it() {
    let camera = photographer(file(true), "lambertian_t20", "ingaas");
    let full = still(150.0, 20.0, 0.0, 9, 0.1);
    let mut half = full.clone();
    half.poses = vec![(0.5, full.poses[0].1), (0.5, crate::pose::Pose { shutter_open: false, ..full.poses[0].1 })];
    let (a, b) = (camera.exposures(&full), camera.exposures(&half));
    for (a, b) in a.iter().zip(&b) {
        assert!((a - 2.0 * b).abs() <= 1e-12 * a.abs());
    }
}

/// The level of light the bench is set to.
#[test]
fn a_grey_sample_reads_one_after_about_a_second_in_f5_green() {
    let camera = photographer(plain(), "lambertian_t20", "ccd");
    let x = camera.exposures(&still(180.0, 0.0, 0.0, 5, 1.0));
    let green = x[528 * 1392 + 697];
    assert_eq!(camera.channel(528, 697), 1);
    assert!((0.8..1.25).contains(&green), "{green}");
    let nir = photographer(plain(), "lambertian_t20", "ingaas").exposures(&still(180.0, 0.0, 0.0, 9, 0.1));
    let nir = nir[135 * 320 + 160];
    assert!((0.2..5.0).contains(&nir), "{nir}");
}

#[test]
#[ignore = "a measurement of cost, run by hand: cargo test -p goniod-sim --lib cost -- --ignored --nocapture"]
#[allow(clippy::print_stdout)]
fn cost_of_a_frame() {
    for (name, camera) in [
        ("lambertian_t20", "ccd"),
        ("prism42", "ccd"),
        ("lambspec_tree", "ccd"),
        ("rough_glass", "ccd"),
        ("clear_glazing", "ccd"),
        ("prism42", "ingaas"),
    ] {
        let bench = file(false);
        let slot = if camera == "ccd" { 5 } else { 9 };
        let photographer = photographer(bench, name, camera);
        let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
        pool.install(|| {
            let start = std::time::Instant::now();
            photographer.raster();
            let raster = start.elapsed();
            let start = std::time::Instant::now();
            let mut pixels = photographer.photograph(&still(150.0, 20.0, 0.0, slot, 1.0), 0, None);
            let first = start.elapsed();
            let mut each = first;
            for frame in 1..9 {
                let start = std::time::Instant::now();
                pixels = photographer.photograph(&still(150.0, 20.0, 0.0, slot, 1.0), frame, Some(pixels));
                each = each.min(start.elapsed());
            }
            println!(
                "{name} {camera}: tracing {raster:.1?}, first of a pose {first:.1?}, then {each:.1?} a frame at best"
            );
        });
    }
}

#[test]
#[ignore = "a measurement of light levels, run by hand with --ignored --nocapture"]
#[allow(clippy::print_stdout)]
fn light_of_every_band() {
    let (ccd, ingaas) =
        (photographer(plain(), "lambertian_t20", "ccd"), photographer(plain(), "lambertian_t20", "ingaas"));
    for slot in 1..=11 {
        let camera = if slot < 9 { &ccd } else { &ingaas };
        let per_second: Vec<f64> = (0..camera.responsivity.len())
            .map(|c| camera.weight(slot, c).map_or(0.0, |w| w.integral()) * 75.0 * 0.2 / std::f64::consts::PI)
            .collect();
        println!("slot {slot}: x per second, T = 0.2 Lambertian, normal incidence: {per_second:.3?}");
    }
}
