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
    let again = lab.goniod(&["resume", &text(&run), "--instrument", &instrument]);
    assert!(again.code == 10 && again.err.contains("this run is finished"), "{}{}", again.out, again.err);
    assert_eq!(lab.goniod(&["verify", &text(&run)]).code, 0, "and it is untouched");
}

/// Frames whose files went bad while nobody worked on the run; what else went bad nobody can take again.
#[test]
fn damaged_frames_are_taken_again_and_other_damage_is_refused() {
    let lab = Lab::small();
    let scan = text(&lab.scan("cut.toml", SCAN));
    let (run, instrument) = (killed_after(&lab, &scan, "runs", 6), text(&lab.instrument()));
    let resume = || lab.goniod(&["resume", &text(&run), "--instrument", &instrument, "--no-products"]);
    let ccd = run.join("frames.zarr/ccd");
    let mut frames: Vec<PathBuf> = fs::read_dir(&ccd).unwrap().flatten().map(|e| e.path()).collect();
    frames.retain(|path| path.file_name().unwrap().to_string_lossy().starts_with("c."));
    frames.sort();
    fs::remove_file(&frames[0]).unwrap();
    let mut bytes = fs::read(&frames[1]).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    fs::write(&frames[1], &bytes).unwrap();
    fs::write(&frames[2], &bytes[..middle]).unwrap();
    fs::write(ccd.join("zarr.json"), "{}").unwrap();
    let plan = fs::read(run.join("inputs/scans/cut.toml")).unwrap();
    fs::write(run.join("inputs/scans/cut.toml"), "other").unwrap();
    let said = resume();
    assert_eq!(said.code, 8, "{}{}", said.out, said.err);
    assert!(
        said.err.contains("inputs/scans/cut.toml was changed") && said.err.contains("goniod verify"),
        "{}",
        said.err
    );
    fs::write(run.join("inputs/scans/cut.toml"), plan).unwrap();
    let said = resume();
    assert_eq!(said.code, 0, "{}{}", said.out, said.err);
    assert_eq!(lab.goniod(&["verify", &text(&run)]).code, 0);
    let verdict = goniod::front::oracle::judge(&run).unwrap();
    assert!(verdict.is_clean() && verdict.stored == verdict.planned, "{:?}", verdict.lines());
    // Nothing is made from what is not what was measured: two frames in each other's place, a plan with another number.
    let reduce = || lab.goniod(&["reduce", &text(&run)]);
    let refused = |words: &str| {
        let said = reduce();
        assert!(said.code != 0 && said.err.contains(words), "{}{}", said.out, said.err);
        assert!(!run.join("products").exists(), "nothing half-made");
    };
    let swap = |to: &Path| fs::rename(&frames[3], to).and_then(|()| fs::rename(&frames[4], &frames[3]));
    let aside = run.join("aside");
    swap(&aside).and_then(|()| fs::rename(&aside, &frames[4])).unwrap();
    refused("not the frame that was stored here");
    swap(&aside).and_then(|()| fs::rename(&aside, &frames[4])).unwrap();
    let plan = fs::read_to_string(run.join("plan.toml")).unwrap();
    fs::write(run.join("plan.toml"), plan.replace("thickness_mm = 4.0", "thickness_mm = 5.0")).unwrap();
    refused("plan.toml was changed");
    fs::write(run.join("plan.toml"), plan).unwrap();
    assert_eq!(reduce().code, 0);
}

#[test]
fn a_run_whose_log_is_damaged_is_refused_until_the_loss_is_accepted_and_is_then_whole() {
    let lab = Lab::small();
    let scan = text(&lab.scan("cut.toml", SCAN));
    let (run, instrument) = (killed_after(&lab, &scan, "runs", 4), text(&lab.instrument()));
    let (log, runs) = (run.join("journal.sqlite-wal"), text(&lab.path("runs")));
    let mut bytes = fs::read(&log).unwrap();
    let half = bytes.len() / 2;
    bytes[half] ^= 1;
    fs::write(&log, &bytes).unwrap();
    let run = text(&run);
    // The newest run is named, not passed over.
    let named = ["resume", &run, "--instrument", &instrument];
    let newest = ["resume", "--runs", &runs, "--instrument", &instrument];
    for args in [&named[..], &newest[..]] {
        let said = lab.goniod(args);
        assert_eq!(said.code, 8, "{}{}", said.out, said.err);
        assert!(said.err.contains("--accept-loss") && said.err.lines().count() == 1, "{}", said.err);
    }
    assert_eq!(fs::read(&log).unwrap(), bytes, "what is refused is not changed");
    let accepted = ["resume", &run, "--instrument", &instrument, "--accept-loss", "--json"];
    let said = lab.goniod(&accepted);
    assert_eq!(said.code, 0, "{}{}", said.out, said.err);
    let document = said.json();
    assert_eq!((document["missing"].as_u64(), document["planned"].as_u64()), (Some(0), Some(0)));
    assert_eq!(lab.goniod(&["verify", &run]).code, 0);
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
    assert_eq!(said.code, 8, "{}{}", said.out, said.err);
    assert!(said.err.contains("plan.toml was changed") && said.err.lines().count() == 1, "{}", said.err);
}

/// Calibrations and spectra may lie anywhere: a run is gone on with wherever its instrument file names them.
#[test]
fn a_run_whose_files_lie_outside_the_instruments_folder_is_gone_on_with() {
    let lab = Lab::small();
    let config = lab.path("config");
    let folders = ["calibration", "spectra", "sim"];
    let named = fs::read_to_string(lab.instrument()).unwrap();
    let inside = folders.iter().filter(|name| config.join(name).is_dir());
    for name in inside {
        fs::rename(config.join(name), lab.path(name)).unwrap();
        assert!(named.contains(&format!("\"{name}/")), "the instrument file names nothing in {name}");
        lab.edit("instrument.sim.toml", &[(&format!("\"{name}/"), &format!("\"../{name}/"))], true);
    }
    let scan = text(&lab.scan("cut.toml", &SCAN.replace("../sim/", "../../sim/")));
    let (run, instrument) = (text(&killed_after(&lab, &scan, "runs", 4)), text(&lab.instrument()));
    assert!(Path::new(&run).join("inputs/outside").is_dir(), "files from outside are kept apart");
    let said = lab.goniod(&["resume", &run, "--instrument", &instrument, "--no-products"]);
    assert_eq!(said.code, 0, "{}{}", said.out, said.err);
    assert_eq!(lab.goniod(&["verify", &run]).code, 0);
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
