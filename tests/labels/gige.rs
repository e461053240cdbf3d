//! The near infrared of the demo through the real camera driver: a GigE Vision twin on loopback UDP photographs the
//! simulated bench in real time, Aravis brings the frames. No label may be wrong, and the BSDF is that of the in-process
//! camera within the stated uncertainties.

use super::{nothing_wrong, rejections};
use crate::common::Lab;
use goniod::config::check::{Checked, Options, check};
use goniod::control::events::EventBus;
use goniod::engine::bsdf::set::PatchValue;
use goniod::front::bench::{Rehearsal, open_with_own_cameras};
use goniod::front::night;
use goniod::front::oracle::Files;
use goniod::products::reduce::{Run, reduce};
use goniod_drivers::clock::Clock;
use goniod_sim::bench::Bench;
use goniod_sim::gige::{GigeTwin, TwinConfig};
use std::net::Ipv4Addr;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::mpsc;

/// Bands and directions of the demo; the lamp is a hundred times as bright, so the times are a hundredth.
const SCAN: &str = r#"
name = "near infrared"
[sample]
thickness_mm = 4.0
symmetry = "isotropic"
simulated = "../sim/samples/rough_glass.toml"
[incidence]
directions = [[0, 180], [10, 180], [20, 180], [30, 180], [40, 180], [50, 180], [60, 180], [70, 180], [82.5, 180]]
sides = ["transmission-front", "reflection-front"]
[bands]
use = ["nir1", "nir2"]
[exposure]
policy = "ladder"
ratio = 16.0
shortest_s = 0.00007
longest_s = 0.32
"#;

/// A lab with a bright lamp and brisk stages.
fn lab() -> Lab {
    let lab = Lab::small();
    lab.edit("sim/bench.toml", &[("irradiance_uw_per_cm2 = 75.0", "irradiance_uw_per_cm2 = 7500.0")], true);
    let brisk = [
        ("speed_deg_per_s = 20.0", "speed_deg_per_s = 120.0"),
        ("per_s2 = 40.0", "per_s2 = 2000.0"),
        ("settle_s = 0.05", "settle_s = 0.02"),
        ("settle_s = 0.1\n", "settle_s = 0.02\n"),
        ("settle_s = 0.2", "settle_s = 0.02"),
    ];
    lab.edit("instrument.sim.toml", &brisk, true);
    lab
}

/// The lab's instrument with the GigE camera at `address` instead of the in-process one.
fn with_gige_camera(lab: &Lab, address: Ipv4Addr) -> PathBuf {
    let path = lab.path("config/instrument.gige.toml");
    let text = std::fs::read_to_string(lab.instrument()).unwrap();
    let text = text.replace(
        "driver = \"sim-ingaas\"\nport = \"sim:ingaas\"",
        &format!("driver = \"aravis\"\nport = \"{address}\""),
    );
    let (head, camera) = text.split_once("[camera.ingaas]").unwrap();
    let camera = camera.replacen("shortest_s = 0.000001", "shortest_s = 0.00002", 1);
    // With a software trigger the twin has no old frames.
    let camera = camera.replacen("discard_frames = 1", "discard_frames = 0", 1);
    std::fs::write(&path, format!("{head}[camera.ingaas]{camera}")).unwrap();
    path
}

/// An address on loopback that no other test has.
fn address() -> Ipv4Addr {
    let [.., high, low] = std::process::id().to_be_bytes();
    Ipv4Addr::new(127, 1 + high % 250, low, 201)
}

/// A twin of the instrument's InGaAs camera that photographs the bench where `poses` stand.
fn twin(checked: &Checked, poses: goniod_sim::twins::Twins, seed: u64, address: Ipv4Addr) -> GigeTwin {
    let (bench, sample) = (checked.bench.as_ref().unwrap(), checked.simulated_sample.as_ref().unwrap());
    let bench = Bench::open(bench, sample, seed, Arc::new(poses), Clock::system()).unwrap();
    let mut config = TwinConfig::quick(address, "INGAAS-0001");
    (config.real_exposure, config.readout) = (true, Duration::from_millis(5));
    GigeTwin::start(config, Arc::new(bench.scene("ingaas").unwrap())).unwrap()
}

/// Measures through Aravis; gives the run directory.
async fn measure_through_aravis(lab: &Lab, scan: &Path) -> PathBuf {
    let options = Options { drivers: Vec::new(), today: jiff::civil::date(2026, 3, 4) };
    let checked = check(scan, &with_gige_camera(lab, address()), &options).unwrap();
    let clock = Clock::system();
    let plan = night::plan(&checked).unwrap();
    let mut opened = open_with_own_cameras(&checked, &Rehearsal::default(), clock).unwrap();
    let twins = opened.faults.as_ref().unwrap().twins.clone();
    let twin = twin(&checked, twins, opened.seed.unwrap(), address());
    let night = night::prepare(&checked, plan, &lab.path("runs"), clock, opened.seed).unwrap();
    let (_verbs, asked) = mpsc::channel(1);
    let outcome = night::measure(&checked, &night, &mut opened, clock, asked, &EventBus::default()).await.unwrap();
    assert!(outcome.is_safe(), "{outcome:?}");
    eprintln!("{:.1} s, {:?}, twin {:?}", clock.elapsed().as_secs_f64(), outcome.summary, twin.traffic());
    assert_eq!((outcome.summary.missing, outcome.summary.planned), (0, 0), "{outcome:?}");
    night.path
}

/// Values of all patches of all columns.
fn patches(run: &Path) -> Vec<PatchValue> {
    let reduction = reduce(&Run::open(run).unwrap()).unwrap();
    reduction.set.columns.iter().flat_map(|c| c.patches.iter().copied()).collect()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_near_infrared_measured_through_a_gige_camera_is_the_same_bsdf() {
    let lab = lab();
    let scan = lab.scan("nir.toml", SCAN);
    let run = measure_through_aravis(&lab, &scan).await;
    let files = Files::open(&run).unwrap();
    let verdict = files.judge().unwrap();
    nothing_wrong(&verdict);
    assert_eq!((verdict.stored, verdict.missing), (files.document.plan.steps.len(), 0));

    let (gige, own) = (patches(&run), patches(&lab.rehearse(&scan, "own", &["--no-products"])));
    assert_eq!(gige.len(), own.len());
    let both = || gige.iter().zip(&own).filter(|(a, b)| a.bsdf.is_finite() && b.bsdf.is_finite());
    let compared = both().count();
    let within = both().filter(|(a, b)| (a.bsdf - b.bsdf).abs() <= 2.0 * a.u.hypot(b.u)).count();
    // What both share (reference, response, geometry) cancels: patches that are read well differ by noise alone.
    let well = |(a, b): &(&PatchValue, &PatchValue)| a.bsdf > 0.0 && b.bsdf > 0.0 && a.u < 0.05 * a.bsdf;
    let ratios: Vec<f64> = both().filter(well).map(|(a, b)| a.bsdf / b.bsdf).collect();
    let (mean, u) = mean(&ratios);
    eprintln!(
        "{} frames, {} rejected, 0 wrong labels; {within} of {compared} patches within k = 2; mean ratio of {} patches {mean:.5} +- {u:.5}",
        verdict.stored,
        rejections(&files).len(),
        ratios.len()
    );
    assert!(compared > 5_000 && ratios.len() > 500, "{compared} patches, {} read well", ratios.len());
    assert!(within * 100 >= compared * 95, "{within} of {compared} patches within k = 2");
    // The lamp walks on between two runs; its steadiness is stated for the way between two references.
    let drift = files.document.instrument.lamp.drift_relative_uncertainty;
    assert!((mean - 1.0).abs() <= 2.0 * u.hypot(drift), "mean ratio {mean} +- {u}");
}

/// Mean and its standard uncertainty.
fn mean(values: &[f64]) -> (f64, f64) {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    let variance = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (n - 1.0);
    (mean, (variance / n).sqrt())
}
