//! Promise: a scan file becomes a BSDF on the simulated bench; the same seed gives the same bytes, another seed others;
//! `verify` notices every changed byte; products can be made again byte for byte; a signal ends a run safely.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stderr)]

mod common;

use common::{Lab, text};
use goniod::engine::optics::side::Side;
use goniod::products::export::klems_read::read_klems;
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

/// One direction on both sides, four bands that reach over Visible and Solar.
const SCAN: &str = r#"
name = "first light"
[sample]
name = "rough glass"
thickness_mm = 4.0
symmetry = "isotropic"
simulated = "../sim/samples/rough_glass.toml"
[incidence]
directions = [[0, 180]]
sides = ["transmission-front", "reflection-front"]
[bands]
use = ["f1", "f4", "f7", "nir3"]
[exposure]
policy = "ladder"
ratio = 8.0
shortest_s = 0.004
longest_s = 2.0
[products]
formats = ["klems-xml", "hdf5"]
"#;

/// The shortest way to frames in real time: the lamp's irradiance instead of diffusers, a pose near home.
const SHORT: &str = r#"
name = "short"
[sample]
thickness_mm = 4.0
simulated = "../sim/samples/rough_glass.toml"
[incidence]
ring = { theta_deg = 2.0, count = 60 }
sides = ["reflection-back"]
[bands]
use = ["f5"]
[exposure]
policy = "ladder"
ratio = 4.0
shortest_s = 0.02
longest_s = 0.5
[dark]
frames = 1
[reference]
mode = "irradiance"
"#;

/// All files below a folder: path relative to it, bytes.
fn files(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    fn collect(folder: &Path, at: &Path, into: &mut BTreeMap<PathBuf, Vec<u8>>) {
        for entry in fs::read_dir(at).unwrap().flatten() {
            if entry.path().is_dir() {
                collect(folder, &entry.path(), into);
            } else {
                into.insert(entry.path().strip_prefix(folder).unwrap().to_owned(), fs::read(entry.path()).unwrap());
            }
        }
    }
    let mut into = BTreeMap::new();
    collect(folder, folder, &mut into);
    into
}

/// Files that differ or are in one folder only.
fn differing(a: &BTreeMap<PathBuf, Vec<u8>>, b: &BTreeMap<PathBuf, Vec<u8>>) -> Vec<PathBuf> {
    let mut names: Vec<&PathBuf> = a.keys().chain(b.keys()).collect();
    names.sort();
    names.dedup();
    names.into_iter().filter(|name| a.get(*name) != b.get(*name)).cloned().collect()
}

#[test]
fn the_same_seed_gives_the_same_bytes_and_products_that_open() {
    let lab = Lab::small();
    let scan = lab.scan("first.toml", SCAN);
    let one = lab.rehearse(&scan, "one", &[]);
    let two = lab.rehearse(&scan, "two", &[]);
    let first = files(&one);
    for name in ["plan.toml", "journal.sqlite", "journal.seal", "frames.zarr/ccd/zarr.json", "products/report.html"] {
        assert!(first.contains_key(Path::new(name)), "{name} is there");
    }
    let chunks = first.keys().filter(|name| name.starts_with("frames.zarr") && !name.ends_with("zarr.json")).count();
    assert_eq!(chunks, 96, "one chunk an exposure");
    let none: Vec<PathBuf> = Vec::new();
    assert_eq!(differing(&first, &files(&two)), none, "the same seed gives the same bytes");
    assert_eq!(lab.goniod(&["verify", &text(&one)]).code, 0);

    let status = lab.goniod(&["status", "--runs", "one", "--json"]).json();
    assert_eq!(status["runs"].as_array().unwrap().len(), 1);
    assert_eq!((&status["runs"][0]["state"], &status["runs"][0]["stored"]), (&"completed".into(), &96.into()));
    let headline = made_again(&lab, &one, &first);
    products_open(&one, &headline);
    one_by_one(&lab, &one, &first);
}

/// The products parse, and say what the headline says.
fn products_open(run: &Path, headline: &[String]) {
    let products = run.join("products");
    let file = read_klems(&fs::read_to_string(products.join("bsdf.xml")).unwrap()).unwrap();
    let report = fs::read_to_string(products.join("report.html")).unwrap();
    let first_section = report.find("<section").unwrap();
    assert!(report[first_section..].starts_with("<section id=\"verdict\""), "the verdict comes first");
    let pictures = files(&products.join("plots"));
    assert!(pictures.len() >= 4, "{:?}", pictures.keys());
    for (name, bytes) in pictures {
        assert!(bytes.starts_with(b"\x89PNG\r\n\x1a\n"), "{}", name.display());
    }
    let h5 = hdf5::File::open(products.join("bsdf.h5")).unwrap();
    assert!(h5.member_names().unwrap().iter().any(|name| name.contains("entry")), "{:?}", h5.member_names());

    for (words, block, side) in [
        ("Transmission Front   visible", "Visible", Side::TransmissionFront),
        ("Transmission Front   solar", "Solar", Side::TransmissionFront),
        ("Reflection Front     visible", "Visible", Side::ReflectionFront),
    ] {
        let line = headline.iter().find(|l| l.starts_with(words)).unwrap_or_else(|| panic!("{words}: {headline:?}"));
        let told: f64 = line.split("°").nth(1).unwrap().split_whitespace().next().unwrap().parse().unwrap();
        let written = file.hemispherical(block, side).unwrap()[0];
        assert!((told - written).abs() < 2e-3 * told, "{line}: the file gives {written}");
        assert!((0.01..0.99).contains(&told), "{line}");
    }
}

/// Everything made again, by any number of threads, is the same byte for byte; gives the headline.
fn made_again(lab: &Lab, run: &Path, first: &BTreeMap<PathBuf, Vec<u8>>) -> Vec<String> {
    let none: Vec<PathBuf> = Vec::new();
    let mut headline = Vec::new();
    for threads in ["1", "4"] {
        fs::remove_dir_all(run.join("products")).unwrap();
        let output = lab.command(&["reduce", &text(run), "--json"]).env("RAYON_NUM_THREADS", threads).output().unwrap();
        assert!(output.status.success());
        assert_eq!(differing(first, &files(run)), none, "{threads} threads");
        let document: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        headline = document["headline"].as_array().unwrap().iter().map(|l| l.as_str().unwrap().to_owned()).collect();
    }
    headline
}

/// Each product by its own command.
fn one_by_one(lab: &Lab, run: &Path, first: &BTreeMap<PathBuf, Vec<u8>>) {
    fs::remove_dir_all(run.join("products")).unwrap();
    for format in ["klems-xml", "hdf5", "klems-xml-bands"] {
        let said = lab.goniod(&["export", &text(run), "--format", format, "--json"]);
        assert_eq!(said.code, 0, "{}", said.err);
        let document = said.json();
        let files = document["files"].as_array().unwrap();
        assert_eq!(files.len(), if format == "klems-xml-bands" { 4 } else { 1 });
        for file in files {
            let path = lab.path(file.as_str().unwrap());
            assert!(fs::metadata(&path).unwrap().len() > 1000, "{}", path.display());
            if path.extension().is_some_and(|e| e == "xml") {
                read_klems(&fs::read_to_string(&path).unwrap()).unwrap();
            }
        }
    }
    assert_eq!(lab.goniod(&["report", &text(run)]).code, 0);
    let again = files(run);
    for name in ["products/bsdf.xml", "products/bsdf.h5", "products/plots/overview.png"] {
        assert!(again.get(Path::new(name)) == first.get(Path::new(name)), "{name}");
    }
    assert_eq!(lab.goniod(&["verify", &text(run)]).code, 0, "products are no part of what verify proves");
}

/// A product that the bands cannot give costs none of the others and is named with its reason.
#[test]
fn one_band_gives_everything_but_the_klems_file_and_says_why() {
    let lab = Lab::small();
    let scan = lab.scan("one_band.toml", &SHORT.replace("count = 60", "count = 1"));
    let checked = lab.goniod(&["check", &text(&scan), "--instrument", &text(&lab.instrument())]);
    assert!(checked.code == 0 && checked.err.contains("far enough for Visible and Solar"), "{}", checked.err);
    let run = lab.rehearse(&scan, "runs", &[]);
    for there in ["products/bsdf.h5", "products/report.html", "products/plots/overview.png"] {
        assert!(run.join(there).is_file(), "{there}");
    }
    assert!(!run.join("products/bsdf.xml").exists());
    let report = fs::read_to_string(run.join("products/report.html")).unwrap();
    assert!(report.contains("NOT MADE: Klems XML"), "{report}");
    let again = lab.goniod(&["reduce", &text(&run), "--json"]).json();
    let not_made = again["not_made"].as_array().unwrap();
    assert!(not_made.len() == 1 && not_made[0].as_str().unwrap().contains("bands do not reach"), "{not_made:?}");
    assert_eq!(
        lab.goniod(&["export", &text(&run), "--format", "klems-xml"]).code,
        6,
        "asked for by name it is an error"
    );
}

#[test]
fn another_seed_gives_other_frames_of_the_same_plan() {
    let lab = Lab::small();
    let scan = lab.scan("first.toml", SCAN);
    let one = files(&lab.rehearse(&scan, "one", &["--no-products"]));
    let other = files(&lab.rehearse(&scan, "other", &["--no-products", "--seed", "7"]));
    let differ = differing(&one, &other);
    let chunks = differ.iter().filter(|name| name.starts_with("frames.zarr")).count();
    assert!(chunks > 48, "{chunks} of 96 frames differ");
    for name in ["plan.toml", "journal.sqlite", "journal.seal"] {
        assert!(differ.contains(&PathBuf::from(name)), "{name}");
    }
    assert!(!differ.iter().any(|name| name.starts_with("inputs") || name.ends_with("zarr.json")), "{differ:?}");
}

#[test]
fn one_changed_byte_anywhere_is_damage_and_is_named() {
    let lab = Lab::small();
    let run = lab.rehearse(&lab.scan("first.toml", SCAN), "runs", &["--no-products"]);
    let path = text(&run);
    assert_eq!(lab.goniod(&["verify", &path]).code, 0);
    let chunk =
        files(&run).into_keys().find(|n| n.starts_with("frames.zarr/ccd") && !n.ends_with("zarr.json")).unwrap();
    let places = [
        (chunk, "frame"),
        ("journal.sqlite".into(), "journal"),
        ("journal.seal".into(), "seal"),
        ("plan.toml".into(), "plan.toml"),
        ("frames.zarr/ccd/zarr.json".into(), "frames.zarr/ccd/zarr.json"),
        ("frames.zarr/zarr.json".into(), "frames.zarr/zarr.json"),
        ("inputs/scans/first.toml".into(), "first.toml"),
    ];
    for (name, word) in places {
        let file = run.join(&name);
        let good = fs::read(&file).unwrap_or_else(|e| panic!("{}: {e}", file.display()));
        for place in [0, good.len() / 2, good.len() - 1] {
            let mut bad = good.clone();
            bad[place] ^= 0x04;
            fs::write(&file, bad).unwrap();
            let said = lab.goniod(&["verify", &path]);
            assert_eq!(said.code, 8, "{} byte {place}: {}{}", name.display(), said.out, said.err);
            assert!(said.out.contains(word), "{} byte {place}: {}", name.display(), said.out);
        }
        fs::remove_file(&file).unwrap();
        let said = lab.goniod(&["verify", &path]);
        // Without its seal a run is one that was not closed; without its journal it is none.
        let code = match name.to_str() {
            Some("journal.seal") => 4,
            Some("journal.sqlite") => 6,
            _ => 8,
        };
        assert_eq!(said.code, code, "{} gone: {}{}", name.display(), said.out, said.err);
        fs::write(&file, good).unwrap();
    }
    assert_eq!(lab.goniod(&["verify", &path]).code, 0, "healed");
}

/// Starts a run in real time, sends the signals once frames are stored, and checks how it ended.
fn stopped_by(signals: &[&str]) {
    let lab = Lab::small();
    for (from, to) in [("speed_deg_per_s = 20.0", "speed_deg_per_s = 90.0"), ("per_s2 = 40.0", "per_s2 = 400.0")] {
        lab.edit("instrument.sim.toml", &[(from, to)], true);
    }
    // Long exposures, so that none ends between two signals.
    let long = SHORT.replace("shortest_s = 0.02", "shortest_s = 0.5").replace("longest_s = 0.5", "longest_s = 2.0");
    let (scan, instrument) = (text(&lab.scan("short.toml", &long)), text(&lab.instrument()));
    let args = ["run", &scan, "--instrument", &instrument, "--runs", "runs", "--no-products", "--json"];
    let child = lab.command(&args).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let begun = Instant::now();
    let stored = || {
        let status = lab.goniod(&["status", "--runs", "runs", "--json"]);
        if status.code == 0 { status.json()["runs"][0]["stored"].as_u64().unwrap_or(0) } else { 0 }
    };
    while stored() < 4 {
        assert!(begun.elapsed() < Duration::from_secs(60), "no frame after a minute");
        std::thread::sleep(Duration::from_millis(300));
    }
    let pid = child.id().to_string();
    for signal in signals {
        assert!(Command::new("kill").args([signal, pid.as_str()]).status().unwrap().success());
        std::thread::sleep(Duration::from_millis(5));
    }
    let output = child.wait_with_output().unwrap();
    let (out, err) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    assert_eq!(output.status.code(), Some(7), "{signals:?}: {out}{err}");
    let document: serde_json::Value = serde_json::from_str(&out).unwrap();
    let ending = if signals.len() == 1 { "stopped" } else { "aborted" };
    assert_eq!((&document["outcome"], &document["ending"]), (&"stopped".into(), &ending.into()), "{out}");
    assert_eq!(document["safe"], true, "{out}");
    let count = |key: &str| document[key].as_u64().unwrap();
    assert!(count("stored") >= 4 && count("planned") > 0 && count("missing") == 0, "{out}");
    let run = lab.path(document["run"].as_str().unwrap());
    assert!(run.join("journal.seal").is_file(), "the journal is sealed");
    let verified = lab.goniod(&["verify", &text(&run), "--json"]);
    assert_eq!(verified.code, 4, "sound, but not complete: {}", verified.out);
    let verified = verified.json();
    assert_eq!((&verified["sound"], &verified["sealed"]), (&true.into(), &true.into()));
    assert_eq!(verified["stored"], document["stored"]);
}

#[test]
fn sigint_ends_a_run_safely() {
    stopped_by(&["-INT"]);
}

#[test]
fn sigterm_ends_a_run_safely() {
    stopped_by(&["-TERM"]);
}

#[test]
fn a_second_signal_ends_it_now() {
    stopped_by(&["-TERM", "-INT"]);
}
