//! Promise: the exported files mean to other programs what they mean to us. Radiance's library, the LBNL engine and
//! h5py read them; T and R agree within 1e-4 and light goes where it should.
//!
//! Needs a Python with `tests/peers/requirements.txt` at `.venv/bin/python` (or `$GONIOD_PYTHON`); says SKIPPED loudly else:
//! `python3 -m venv .venv && .venv/bin/pip install -r tests/peers/requirements.txt`.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stderr)]

mod common;

use goniod::archive::write_atomic;
use goniod::engine::bsdf::set::{BsdfSet, Column, PatchValue, Quantity};
use goniod::engine::optics::basis::AngleBasis;
use goniod::engine::optics::direction::Direction;
use goniod::engine::optics::side::Side;
use goniod::products::context::{Checks, Counts, ProductContext, SampleHeader};
use goniod::products::export::hdf5_nexus::write_hdf5;
use goniod::products::export::klems_read::{KlemsFile, read_klems};
use goniod::products::export::klems_xml::{klems_xml, klems_xml_band};
use goniod::products::export::matrix::{FilledBlock, Origin, PATCHES};
use goniod::products::reduce::{Run, reduce};
use serde_json::Value;
use std::f64::consts::PI;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Directions of the comparison, in the file's words: normal, oblique, mirrored pairs, grazing.
const DIRECTIONS: [&str; 7] = ["0,0", "40,270", "40,0", "20,45", "60,105", "82.5,240", "40,90"];
const TOLERANCE: f64 = 1e-4;

fn python() -> Option<PathBuf> {
    let own = Path::new(env!("CARGO_MANIFEST_DIR")).join(".venv/bin/python");
    let python = std::env::var_os("GONIOD_PYTHON").map_or(own, PathBuf::from);
    let probe = Command::new(&python).args(["-c", "import pyradiance, pywincalc, h5py, numpy"]).output();
    if probe.is_ok_and(|o| o.status.success()) {
        return Some(python);
    }
    eprintln!("\n*** SKIPPED: no Python with tests/peers/requirements.txt at {} ***\n", python.display());
    None
}

fn ask(python: &Path, script: &str, arguments: &[&str]) -> Value {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/peers").join(script);
    let out = Command::new(python).arg(script).args(arguments).output().unwrap();
    assert!(out.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&out.stderr));
    let text = String::from_utf8(out.stdout).unwrap();
    serde_json::from_str(text.lines().last().unwrap_or_default()).unwrap()
}

fn context() -> ProductContext {
    ProductContext {
        run_id: "peers".to_owned(),
        scan_name: "peers".to_owned(),
        sample: SampleHeader {
            name: "<test> & \"sample\"".to_owned(),
            manufacturer: String::new(),
            thickness_mm: 3.0,
            device_type: None,
        },
        instrument: "none".to_owned(),
        serials: vec![],
        started: "2026-03-04T18:00:00Z".parse().unwrap(),
        finished: None,
        lamp: "none".to_owned(),
        lamp_hours: None,
        normalisation: "constructed".to_owned(),
        bands: vec![],
        plan_hash: "0".to_owned(),
        versions: vec![],
        night: Vec::new(),
        counts: Counts::default(),
        checks: Checks::default(),
        uncertainty: vec![],
        notes: vec![],
    }
}

fn column(side: Side, incident: Direction, values: &[f64]) -> Column {
    let solid = AngleBasis::klems_full().projected_solid_angles();
    let patch = |&bsdf: &f64| PatchValue { bsdf, u: 0.01 * bsdf, u_random: 0.002 * bsdf, coverage: 1.0, max: bsdf };
    let hemispherical = values.iter().zip(&solid).map(|(v, l)| v * l).sum();
    let patches = values.iter().map(patch).collect();
    Column { side, incident, quantity: 0, patches, hemispherical, hemispherical_u: 0.01 * hemispherical }
}

/// A set with every Klems direction as source; `values(side, emergent patch, patch where the light would go straight on)`.
fn set(sides: &[Side], values: impl Fn(Side, usize, usize) -> f64) -> BsdfSet {
    let basis = AngleBasis::klems_full();
    let mut columns = Vec::new();
    for &side in sides {
        for incident in (0..PATCHES).filter_map(|p| basis.centre(p)) {
            let straight = basis.patch_of(Side::file_incident(incident)).unwrap();
            let of_patch: Vec<f64> = (0..PATCHES).map(|o| values(side, o, straight)).collect();
            columns.push(column(side, incident, &of_patch));
        }
    }
    BsdfSet { basis, quantities: vec![Quantity::Visible], columns }
}

fn lambertian_and_direct(sides: &[Side]) -> BsdfSet {
    let solid = AngleBasis::klems_full().projected_solid_angles();
    set(sides, move |side, o, straight| {
        let (diffuse, direct) = match side {
            Side::TransmissionFront | Side::TransmissionBack => (0.2, 0.5),
            Side::ReflectionFront => (0.1, 0.05),
            Side::ReflectionBack => (0.12, 0.0),
        };
        diffuse / PI + if o == straight { direct / solid[o] } else { 0.0 }
    })
}

fn blocks(set: &BsdfSet) -> Vec<FilledBlock> {
    Side::ALL.iter().filter_map(|&s| FilledBlock::from_measured(set, 0, s).unwrap()).collect()
}

fn compare(peer: &Value, key: &str, expected: &[f64], who: &str) {
    let got: Vec<f64> = peer[key].as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect();
    for ((direction, g), e) in DIRECTIONS.iter().zip(&got).zip(expected) {
        assert!((g - e).abs() < TOLERANCE, "{who} {key} at {direction}: {g} instead of {e}");
    }
    assert_eq!(got.len(), expected.len());
}

/// Our own sums at the directions of the comparison.
fn own(file: &KlemsFile, side: Side) -> Vec<f64> {
    let sums = file.hemispherical("Visible", side).unwrap();
    let patch = |words: &str| {
        let (theta, phi) = words.split_once(',').unwrap();
        file.basis.patch_of(Direction::from_degrees(theta.parse().unwrap(), phi.parse().unwrap())).unwrap()
    };
    DIRECTIONS.iter().map(|w| sums[patch(w)]).collect()
}

fn check_with(readers: &[&str], python: &Path, xml: &str, folder: &Path) {
    let file = read_klems(xml).unwrap();
    let path = folder.join("peer.xml");
    write_atomic(&path, xml.as_bytes()).unwrap();
    for who in readers {
        let mut arguments = vec![*who, path.to_str().unwrap()];
        arguments.extend(DIRECTIONS);
        let peer = ask(python, "klems.py", &arguments);
        compare(&peer, "T", &own(&file, Side::TransmissionFront), who);
        compare(&peer, "Rf", &own(&file, Side::ReflectionFront), who);
        compare(&peer, "Rb", &own(&file, Side::ReflectionBack), who);
    }
}

#[test]
fn lambertian_and_direct_light_is_read_alike() {
    let Some(python) = python() else { return };
    let folder = tempfile::tempdir().unwrap();
    let set = lambertian_and_direct(&[Side::TransmissionFront, Side::ReflectionFront, Side::ReflectionBack]);
    let known = blocks(&set);
    let xml = klems_xml(&context(), &known, &known, &context().uncertainty_summary(&set)).unwrap();
    let t = own(&read_klems(&xml).unwrap(), Side::TransmissionBack);
    assert!(t.iter().all(|t| (t - 0.7).abs() < 1e-6), "back transmission comes by reciprocity: {t:?}");
    check_with(&["radiance", "lbnl"], &python, &xml, folder.path());
    let band = Quantity::Band { name: "f3".to_owned(), interval_nm: [500.0, 560.0] };
    let xml = klems_xml_band(&context(), &band, &known, "").unwrap();
    check_with(&["radiance"], &python, &xml, folder.path());
}

/// The film is not symmetric: light from above and from below differ, so a wrong azimuth shows at once.
#[test]
fn an_asymmetric_film_is_read_alike() {
    let Some(python) = python() else { return };
    let folder = tempfile::tempdir().unwrap();
    let sample = Path::new(env!("CARGO_MANIFEST_DIR")).join("config/sim/samples/prism42_raytraced_klems.xml");
    let sample = read_klems(&std::fs::read_to_string(sample).unwrap()).unwrap();
    let block = |side| {
        let values = sample.block("Visible", side).unwrap().values.clone();
        FilledBlock { side, values, origin: vec![Origin::Measured; PATCHES] }
    };
    let known: Vec<FilledBlock> = Side::ALL.into_iter().map(block).collect();
    let xml = klems_xml(&context(), &known, &known, "").unwrap();
    // Values of this film as Radiance and the LBNL engine gave them for the original file.
    let t = own(&read_klems(&xml).unwrap(), Side::TransmissionFront);
    assert!((t[6] - 0.606206).abs() < 1e-5 && (t[1] - 0.817169).abs() < 1e-5, "{t:?}");
    check_with(&["radiance", "lbnl", "solar"], &python, &xml, folder.path());
}

/// One entry only: light from below (source azimuth 270), travelling towards azimuth 90, leaving at (30, 0).
#[test]
fn a_single_entry_answers_to_its_own_direction_only() {
    let Some(python) = python() else { return };
    let folder = tempfile::tempdir().unwrap();
    let basis = AngleBasis::klems_full();
    let (hit, l) = (25, basis.projected_solid_angles()[25]);
    let travels = basis.patch_of(Direction::from_degrees(40.0, 90.0)).unwrap();
    let entry = |_, o, straight| if o == hit && straight == travels { 0.6 / l } else { 0.0 };
    let known = blocks(&set(&[Side::TransmissionFront], entry));
    let xml = klems_xml(&context(), &known, &known, "").unwrap();
    let path = folder.path().join("single.xml");
    write_atomic(&path, xml.as_bytes()).unwrap();
    let answer = ask(&python, "klems.py", &["orientation", path.to_str().unwrap(), "40,90", "30,0"]);
    let (right, wrong) = (answer["named by travel"].as_f64().unwrap(), answer["named by source"].as_f64().unwrap());
    assert!((right * l - 0.6).abs() < 1e-3, "entry reads {right}, {} was written", 0.6 / l);
    assert!(wrong.abs() < 1e-6, "light from the opposite azimuth gives {wrong}");
    let mut arguments = vec!["lbnl", path.to_str().unwrap()];
    arguments.extend(DIRECTIONS);
    let lbnl = ask(&python, "klems.py", &arguments);
    compare(&lbnl, "T", &[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.6], "lbnl");
}

#[test]
fn h5py_follows_the_default_chain_and_finds_consistent_numbers() {
    let Some(python) = python() else { return };
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("bsdf.h5");
    write_hdf5(&path, &lambertian_and_direct(&[Side::TransmissionFront, Side::ReflectionFront]), &context(), &[])
        .unwrap();
    let found = ask(&python, "nexus.py", &[path.to_str().unwrap()]);
    assert_eq!(found["chain"], serde_json::json!(["NXroot", "NXentry", "NXdata"]));
    assert_eq!(found["axes"], serde_json::json!(["side", "incident", "quantity", "patch"]));
    assert_eq!(found["shape"], serde_json::json!([2, 145, 1, 145]));
    assert_eq!(found["errors_shape"], found["shape"]);
    assert_eq!(found["lengths_match"], true);
    assert_eq!(found["units"], "1/sr");
    assert_eq!(found["sides"], serde_json::json!(["Transmission Front", "Reflection Front"]));
    assert!(found["worst_sum"].as_f64().unwrap() < 1e-12);
}

/// The demo's scan measured with a small camera: what the run says of T and R is what both engines read from its file.
#[test]
fn the_demo_is_read_with_the_numbers_of_its_own_run() {
    let Some(python) = python() else { return };
    let lab = common::Lab::small();
    let run = lab.rehearse(&lab.path("config/scans/demo.toml"), "runs", &[]);
    let set = reduce(&Run::open(&run).unwrap()).unwrap().set;
    let xml = run.join("products/bsdf.xml");
    let visible = set.quantities.iter().position(|q| *q == Quantity::Visible).unwrap();
    let of = |side: Side| -> Vec<f64> {
        let columns = set.columns.iter().filter(|c| c.quantity == visible && c.side == side);
        columns.map(|c| c.hemispherical).collect()
    };
    let directions = ["0,0", "10,0", "20,0", "30,0", "40,0", "50,0", "60,0", "70,0", "82.5,0"];
    for reader in ["radiance", "lbnl"] {
        let mut arguments = vec![reader, xml.to_str().unwrap()];
        arguments.extend(directions);
        let peer = ask(&python, "klems.py", &arguments);
        for (key, side) in [("T", Side::TransmissionFront), ("Rf", Side::ReflectionFront)] {
            let got: Vec<f64> = peer[key].as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect();
            let ours = of(side);
            assert_eq!(got.len(), ours.len());
            for ((direction, g), e) in directions.iter().zip(&got).zip(&ours) {
                assert!((g - e).abs() < TOLERANCE, "{reader} {key} at {direction}: {g} instead of {e}");
            }
        }
    }
}
