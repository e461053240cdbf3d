//! Promise: a run that was killed, stopped or cut short is gone on with at the exposure where it ended, by one command,
//! and by nobody else, and not with another instrument.
#![allow(clippy::unwrap_used, clippy::expect_used)]

mod common;

use common::{Lab, text};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::time::Duration;

const SCAN: &str = r#"
name = "cut"
[sample]
thickness_mm = 4.0
simulated = "../sim/samples/rough_glass.toml"
[incidence]
directions = [[0, 0], [30, 0], [60, 0]]
sides = ["transmission-front"]
[bands]
use = ["f2", "f5", "nir1"]
[exposure]
policy = "ladder"
ratio = 8.0
shortest_s = 0.03
longest_s = 2.0
[reference]
every_directions = 2
[products]
formats = ["hdf5"]
"#;

/// Stored chunks of a run.
fn chunks(run: &Path) -> usize {
    let folder = |camera: &str| fs::read_dir(run.join("frames.zarr").join(camera)).into_iter().flatten().flatten();
    let is_chunk = |entry: &fs::DirEntry| entry.file_name().to_string_lossy().starts_with("c.");
    ["ccd", "ingaas"].iter().map(|camera| folder(camera).filter(is_chunk).count()).sum()
}

/// A rehearsal killed once it has stored `frames` frames; its run directory.
fn killed_after(lab: &Lab, scan: &str, runs: &str, frames: usize) -> PathBuf {
    killed_with(lab, scan, runs, frames, &[])
}

/// The same with more arguments.
fn killed_with(lab: &Lab, scan: &str, runs: &str, frames: usize, more: &[&str]) -> PathBuf {
    let runs = lab.path(runs);
    let args = ["rehearse", scan, "--instrument", &text(&lab.instrument()), "--runs", &text(&runs), "--no-products"];
    let mut child =
        lab.command(&[&args[..], more].concat()).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    let run = || fs::read_dir(&runs).ok()?.flatten().map(|e| e.path()).find(|p| p.join("journal.sqlite").is_file());
    loop {
        if run().is_some_and(|run| chunks(&run) >= frames) {
            break;
        }
        assert!(child.try_wait().unwrap().is_none(), "it ended before it could be killed");
        std::thread::sleep(Duration::from_millis(2));
    }
    child.kill().unwrap();
    child.wait().unwrap();
    run().unwrap()
}

#[test]
fn a_killed_run_is_gone_on_with_by_one_command_and_is_then_whole() {
    let lab = Lab::small();
    let scan = text(&lab.scan("cut.toml", SCAN));
    let (run, instrument) = (killed_after(&lab, &scan, "runs", 4), text(&lab.instrument()));
    let before = chunks(&run);
    let runs = text(&lab.path("runs"));
    let said = lab.goniod(&["resume", "--runs", &runs, "--instrument", &instrument, "--json"]);
    assert_eq!(said.code, 0, "{}{}", said.out, said.err);
    let document = said.json();
    assert_eq!((document["missing"].as_u64(), document["planned"].as_u64()), (Some(0), Some(0)));
    assert_eq!(document["stored"].as_u64().unwrap() as usize, chunks(&run));
    assert!(chunks(&run) > before && !document["products"].as_array().unwrap().is_empty());
    assert_eq!(lab.goniod(&["verify", &text(&run)]).code, 0);

    let again = lab.goniod(&["resume", "--runs", &runs, "--instrument", &instrument]);
    assert_eq!(again.code, 3, "{}{}", again.out, again.err);
    assert!(again.err.contains("every run is finished"), "{}", again.err);
}

#[test]
fn a_run_is_not_gone_on_with_by_another_instrument_or_calibration_and_each_difference_is_told() {
    let lab = Lab::small();
    let scan = text(&lab.scan("cut.toml", SCAN));
    let (run, instrument) = (text(&killed_after(&lab, &scan, "runs", 2)), text(&lab.instrument()));
    let refused = |words: &[&str]| {
        let said = lab.goniod(&["resume", &run, "--instrument", &instrument]);
        assert_eq!(said.code, 3, "{}{}", said.out, said.err);
        for word in words {
            assert!(said.err.contains(word), "{word} is not in {}", said.err);
        }
    };
    lab.edit("instrument.sim.toml", &[("serial = \"50002\"", "serial = \"50009\"")], true);
    refused(&["holder.spin.serial", "50002", "50009"]);
    lab.edit("instrument.sim.toml", &[("serial = \"50009\"", "serial = \"50002\"")], true);
    let calibration = lab.path("config/calibration/ccd.sim.toml");
    let good = fs::read_to_string(&calibration).unwrap();
    fs::write(&calibration, format!("{good}\n# touched\n")).unwrap();
    refused(&["calibration.ccd", "SHA-256"]);
    fs::write(&calibration, good).unwrap();
    fs::write(Path::new(&run).join("plan.toml"), "broken").unwrap();
    let said = lab.goniod(&["resume", &run, "--instrument", &instrument]);
    assert_eq!(said.code, 6, "{}{}", said.out, said.err);
}

/// A sample that only the command line named lies in the bench again.
#[test]
fn a_rehearsal_of_another_sample_is_gone_on_with_with_that_sample() {
    let lab = Lab::small();
    let scan = text(&lab.scan("cut.toml", SCAN));
    let other = lab.path("elsewhere.toml");
    fs::copy(lab.path("config/sim/samples/lambertian_t20.toml"), &other).unwrap();
    let run = killed_with(&lab, &scan, "runs", 4, &["--sample", &text(&other)]);
    let instrument = text(&lab.instrument());
    let resume = || lab.goniod(&["resume", &text(&run), "--instrument", &instrument, "--no-products"]);
    let good = fs::read_to_string(&other).unwrap();
    fs::write(&other, format!("{good}\n# another one\n")).unwrap();
    let said = resume();
    assert!(said.code == 3 && said.err.contains("sample.simulated"), "{}{}", said.out, said.err);
    fs::write(&other, good).unwrap();
    let said = resume();
    assert_eq!(said.code, 0, "{}{}", said.out, said.err);
    assert_eq!(lab.goniod(&["verify", &text(&run)]).code, 0);
    let verdict = goniod::front::oracle::judge(&run).unwrap();
    assert!(verdict.is_clean() && verdict.pairs_telling > 0, "{:?}", verdict.lines());
}

/// In the time of the wall: the same command again goes on by itself where the instrument wants that.
#[test]
fn a_run_cut_short_is_gone_on_with_by_itself_where_the_instrument_says_so() {
    let lab = Lab::small();
    lab.edit("instrument.sim.toml", &[("runs_dir = \"runs\"\n", "runs_dir = \"runs\"\nauto_resume = true\n")], true);
    let quick = [("[[0, 0], [30, 0], [60, 0]]", "[[0, 0]]"), ("\"f2\", \"f5\", \"nir1\"", "\"f5\""), ("2.0", "0.25")];
    let quick = quick.iter().fold(SCAN.to_owned(), |text, (from, to)| text.replace(from, to));
    let (scan, instrument) = (text(&lab.scan("quick.toml", &quick)), text(&lab.instrument()));
    let args = ["run", &scan, "--instrument", &instrument, "--no-products"];
    let mut child = lab.command(&args).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    let run = || fs::read_dir(lab.path("runs")).ok()?.flatten().map(|e| e.path()).find(|p| p.is_dir());
    while run().is_none_or(|run| chunks(&run) < 2) {
        assert!(child.try_wait().unwrap().is_none(), "it ended before it could be killed");
        std::thread::sleep(Duration::from_millis(2));
    }
    let other = lab.goniod(&["resume", &text(&run().unwrap()), "--instrument", &instrument]);
    assert!(other.code != 0 && other.err.contains("is in use by process"), "{}", other.err);
    child.kill().unwrap();
    child.wait().unwrap();
    let said = lab.goniod(&args);
    assert_eq!(said.code, 0, "{}{}", said.out, said.err);
    assert!(said.out.contains("going on with"), "{}", said.out);
    assert_eq!(fs::read_dir(lab.path("runs")).unwrap().count(), 1, "no second run was begun");
    assert_eq!(lab.goniod(&["verify", &text(&run().unwrap())]).code, 0);
}

#[test]
fn the_bench_is_made_safe_by_hand_and_each_device_tells_how_it_stands() {
    let lab = Lab::small();
    let said = lab.goniod(&["safe", "--direct", "--instrument", &text(&lab.instrument()), "--json"]);
    assert_eq!(said.code, 0, "{}{}", said.out, said.err);
    let devices = said.json()["devices"].as_array().unwrap().clone();
    let names: Vec<&str> = devices.iter().map(|d| d["device"].as_str().unwrap()).collect();
    assert_eq!(names, ["shutter", "tilt", "spin", "changer", "filter_wheel"]);
    assert!(devices.iter().all(|d| d["outcome"] == "confirmed"), "{devices:?}");
    let ports = ["holder", "filter-wheel", "shutter", "monochromator"];
    let real = ports.map(|name| (format!("\"sim:{name}\""), format!("\"/dev/no-{name}\"")));
    let pairs: Vec<(&str, &str)> = real.iter().map(|(a, b)| (a.as_str(), b.as_str())).collect();
    lab.edit("instrument.sim.toml", &pairs, true);
    let said = lab.goniod(&["safe", "--direct", "--instrument", &text(&lab.instrument())]);
    assert_eq!(said.code, 5, "{}{}", said.out, said.err);
    assert_eq!(said.out.matches("unreachable").count(), 5, "all are tried although each fails: {}", said.out);
}
