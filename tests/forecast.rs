//! Promise: the forecast is within 2 % of the run: the operator may believe when it says when it will be done.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stderr)]

mod common;

use common::{Lab, text};

const WITHIN: f64 = 0.02;

/// One ring, from both sides of the holder.
const RING: &str = r#"
name = "ring"
[sample]
thickness_mm = 4.0
simulated = "../sim/samples/rough_glass.toml"
[incidence]
ring = { theta_deg = 40.0, count = 3 }
sides = ["transmission-front", "reflection-front"]
[bands]
use = ["f3", "f5"]
[exposure]
policy = "ladder"
ratio = 8.0
shortest_s = 0.0009
longest_s = 4.0
"#;

/// Clear glass on all four sides: narrow peaks, a ladder down to the shortest exposures.
const GLAZING: &str = r#"
name = "glazing on four sides"
[sample]
thickness_mm = 3.0
simulated = "../sim/samples/clear_glazing.toml"
[incidence]
directions = [[0, 180], [60, 180]]
sides = ["transmission-front", "reflection-front", "transmission-back", "reflection-back"]
[bands]
use = ["f2", "f6"]
[exposure]
policy = "ladder"
ratio = 8.0
shortest_s = 0.0000014
longest_s = 2.0
"#;

/// Both cameras, with darks and references in between.
const RHYTHM: &str = r#"
name = "both cameras in a rhythm"
[sample]
thickness_mm = 3.0
simulated = "../sim/samples/lambertian_t20.toml"
[incidence]
directions = [[0, 0], [25, 0], [50, 90], [50, 180]]
sides = ["transmission-front"]
[bands]
use = ["f5", "f8", "nir1", "nir3"]
[exposure]
policy = "ladder"
ratio = 4.0
shortest_s = 0.001
longest_s = 2.0
[dark]
every_directions = 2
frames = 2
[reference]
every_directions = 2
"#;

/// Rehearses and gives (forecast, run) in seconds.
fn compare(lab: &Lab, name: &str, scan: &str) -> (f64, f64) {
    let (scan, instrument) = (text(&lab.scan(name, scan)), text(&lab.instrument()));
    let said =
        lab.goniod(&["rehearse", &scan, "--instrument", &instrument, "--runs", "runs", "--no-products", "--json"]);
    assert_eq!(said.code, 0, "{}{}", said.out, said.err);
    let document = said.json();
    let (forecast_s, took_s) = (document["forecast_s"].as_f64().unwrap(), document["took_s"].as_f64().unwrap());
    eprintln!("{name}: forecast {forecast_s:.1} s, run {took_s:.1} s, {:+.2} %", 100.0 * (forecast_s / took_s - 1.0));
    let planned = lab.goniod(&["plan", &scan, "--instrument", &instrument, "--json"]).json();
    assert!((planned["forecast_total_s"].as_f64().unwrap() - forecast_s).abs() < 1e-6, "plan and run agree");
    (forecast_s, took_s)
}

fn within(lab: &Lab, name: &str, scan: &str) {
    let (forecast_s, took_s) = compare(lab, name, scan);
    assert!((forecast_s / took_s - 1.0).abs() < WITHIN, "{name}: forecast {forecast_s:.1} s, run {took_s:.1} s");
}

#[test]
fn one_ring_in_transmission_and_reflection() {
    within(&Lab::small(), "ring.toml", RING);
}

#[test]
fn clear_glass_on_four_sides() {
    within(&Lab::small(), "glazing.toml", GLAZING);
}

#[test]
fn two_cameras_with_darks_and_references() {
    within(&Lab::small(), "rhythm.toml", RHYTHM);
}

/// Cameras whose stream cannot be restarted wait for long frames with the settings before: the forecast knows.
#[test]
fn cameras_that_only_run_free() {
    let lab = Lab::small();
    lab.free_running(3);
    within(&lab, "ring.toml", RING);
    let (free_s, _) = compare(&lab, "free.toml", RHYTHM);
    let (restarting_s, _) = compare(&Lab::small(), "restarting.toml", RHYTHM);
    assert!(free_s > restarting_s + 60.0, "{free_s} s and {restarting_s} s");
}

#[test]
fn the_kinds_of_time_add_up_and_the_finish_follows_the_start() {
    let lab = Lab::small();
    let (scan, instrument) = (text(&lab.scan("ring.toml", RING)), text(&lab.instrument()));
    let start = "2026-03-04T18:00:00Z";
    let plan = lab.goniod(&["plan", &scan, "--instrument", &instrument, "--start", start, "--json"]).json();
    let kinds = ["start_s", "moving_s", "filter_s", "shutter_s", "exposing_s", "overhead_s"];
    let sum: f64 = kinds.iter().map(|kind| plan["forecast"][kind].as_f64().unwrap()).sum();
    let total_s = plan["forecast_total_s"].as_f64().unwrap();
    assert!((sum - total_s).abs() < 1e-6);
    let stamp = |key: &str| plan[key].as_str().unwrap().parse::<jiff::Timestamp>().unwrap();
    let lasts_s = (stamp("finish").as_microsecond() - stamp("start").as_microsecond()) as f64 / 1e6;
    assert!((lasts_s - total_s).abs() < 1e-3, "{lasts_s}");
}
