//! Promise: a hand moves one device through the same table, instrument file and limits as a run.
#![allow(clippy::unwrap_used, clippy::expect_used)]

mod common;

use common::{Lab, Said, text};

/// The small lab with a light monitor in its instrument.
fn lab() -> Lab {
    let lab = Lab::small();
    let monitor =
        "[light_monitor]\ndriver = \"newport-1830c\"\nport = \"sim:light-monitor\"\nwavelength_nm = 550.0\n\n";
    lab.edit("instrument.sim.toml", &[("[camera.ccd]\n", &format!("{monitor}[camera.ccd]\n"))], true);
    lab
}

fn device(lab: &Lab, args: &[&str]) -> Said {
    let instrument = text(&lab.instrument());
    let mut all = vec!["device", "--instrument", &instrument, "--json"];
    all.extend(args);
    lab.goniod(&all)
}

#[test]
fn the_list_names_every_device_and_the_one_that_is_not_there() {
    let lab = lab();
    let said = device(&lab, &["list"]);
    assert_eq!(said.code, 0, "{}{}", said.out, said.err);
    let listed = said.json();
    let names: Vec<&str> = listed["devices"].as_array().unwrap().iter().map(|d| d["name"].as_str().unwrap()).collect();
    let all = ["shutter", "filter_wheel", "changer", "tilt", "spin", "light_monitor", "monochromator", "ccd", "ingaas"];
    assert_eq!(names, all);
    assert_eq!(listed["devices"][3]["identity"]["serial"], "50001");
    lab.edit("instrument.sim.toml", &[("port = \"sim:monochromator\"", "port = \"sim:nowhere\"")], true);
    let said = device(&lab, &["list"]);
    assert_eq!(said.code, 5);
    let monochromator = &said.json()["devices"][6];
    assert!(monochromator["error"].as_str().unwrap().contains("sim:monochromator"), "{monochromator}");
    assert!(said.json()["devices"][7]["identity"].is_object(), "the others are listed all the same");
}

#[test]
fn each_device_moves_and_says_where_it_stands() {
    let lab = lab();
    for (name, to, state) in [
        ("tilt", "30", "30°"),
        ("tilt", "home", "0°"),
        ("filter_wheel", "3", "slot 3"),
        ("filter_wheel", "nir2", "slot 10"),
        ("shutter", "open", "open"),
        ("shutter", "closed", "closed"),
        ("monochromator", "550", "550 nm"),
    ] {
        let said = device(&lab, &["move", name, to]);
        assert_eq!(said.code, 0, "{name} {to}: {}{}", said.out, said.err);
        assert_eq!(said.json()["state"], state, "{name} {to}");
    }
    let shown = device(&lab, &["show", "shutter"]).json();
    assert_eq!((shown["state"].as_str(), shown["health"]["warnings"].as_array().unwrap().len()), (Some("closed"), 0));
}

#[test]
fn what_is_not_permitted_is_refused_with_what_is() {
    let lab = lab();
    for (args, words) in [
        (&["move", "tilt", "200"][..], "from -2 to 182 degrees"),
        (&["move", "tilt", "upwards"], "write an angle from -2 to 182"),
        (&["move", "tilt", "NaN"], "from -2 to 182 degrees"),
        (&["move", "filter_wheel", "13"], "write 1 to 12 or a band"),
        (&["move", "shutter", "ajar"], "write `open` or `closed`"),
        (&["move", "monochromator", "1200"], "from 300 to 1100 nanometres"),
        (&["move", "ccd", "1"], "`ccd` does not move"),
        (&["show", "tiltt"], "no device `tiltt`; there are: shutter, filter_wheel"),
        (&["read", "ccd", "--exposure", "1e9"], "is allowed"),
    ] {
        let said = device(&lab, args);
        assert_eq!(said.code, 2, "{args:?}: {}{}", said.out, said.err);
        assert!(said.err.contains(words), "{args:?}: {}", said.err);
    }
}

#[test]
fn light_is_read_by_monitor_and_camera() {
    let lab = lab();
    let power = device(&lab, &["read", "light_monitor"]).json()["reading"]["power_w"].as_f64().unwrap();
    assert!((power / 1e-3 - 1.0).abs() < 0.01, "{power}");
    let frame = device(&lab, &["read", "ccd", "--exposure", "0.05"]).json();
    assert_eq!(frame["reading"]["exposure_s"], 0.05);
    assert!(frame["reading"]["max_level"].as_f64().unwrap() > 0.0, "painted truth is in the picture: {frame}");
}

/// The real driver against the spectrometer's twin, in the light of the lamp's model.
#[test]
fn a_simulated_spectrometer_tells_who_it_is_and_takes_a_spectrum() {
    let lab = lab();
    let table = |port: &str| {
        format!(
            "[spectrometer]\ndriver = \"oceanoptics-usb\"\nport = \"{port}\"\nserial = \"USB2G77\"\n\n[camera.ccd]\n"
        )
    };
    lab.edit("instrument.sim.toml", &[("[camera.ccd]\n", &table("sim:spectrometer"))], true);
    let shown = device(&lab, &["show", "spectrometer"]);
    assert_eq!(shown.code, 0, "{}{}", shown.out, shown.err);
    assert_eq!(shown.json()["identity"]["serial"], "USB2G77");
    let read = device(&lab, &["read", "spectrometer", "--exposure", "0.1"]);
    assert_eq!(read.code, 0, "{}{}", read.out, read.err);
    assert_eq!(read.json()["reading"]["exposure_s"], 0.1);
    lab.edit("instrument.sim.toml", &[("sim:spectrometer", "sim:prism")], true);
    let said = device(&lab, &["show", "spectrometer"]);
    assert!(said.code != 0 && format!("{}{}", said.out, said.err).contains("sim:spectrometer"), "{}", said.err);
}

/// The kernel holds the lock for whoever has the instrument; a hand waits outside.
#[test]
fn an_instrument_in_use_is_left_alone() {
    let lab = lab();
    let first = device(&lab, &["show", "shutter"]);
    assert_eq!(first.code, 0, "{}{}", first.out, first.err);
    let folder = if std::path::Path::new("/run/lock").is_dir() { "/run/lock".into() } else { std::env::temp_dir() };
    let real = std::fs::canonicalize(lab.instrument()).unwrap();
    let digest = goniod::digest::sha256_hex(real.to_string_lossy().as_bytes());
    let lock = std::fs::File::open(folder.join(format!("goniod-{}.lock", &digest[..16]))).unwrap();
    lock.lock().unwrap();
    let said = device(&lab, &["move", "shutter", "open"]);
    assert_eq!(said.code, 10, "refused: {}", said.err);
    assert!(said.err.contains("is in use"), "{}", said.err);
    drop(lock);
    assert_eq!(device(&lab, &["show", "shutter"]).code, 0);
}

/// The run reads the twin through the real driver before each view; the journal keeps what it said.
#[test]
fn a_rehearsal_reads_the_lamp_through_the_monitor() {
    let lab = lab();
    let scan = lab.path("config/scans/small.toml");
    std::fs::write(
        &scan,
        "name = \"small\"\n[sample]\nthickness_mm = 4.0\nsimulated = \"../sim/samples/rough_glass.toml\"\n\
         [incidence]\ndirections = [[0, 180]]\nsides = [\"transmission-front\"]\n[bands]\nuse = [\"f5\"]\n\
         [exposure]\npolicy = \"ladder\"\nratio = 8.0\nshortest_s = 0.03\nlongest_s = 2.0\n",
    )
    .unwrap();
    let run = lab.rehearse(&scan, "runs", &["--no-products"]);
    let dir = goniod::archive::RunDir::open(&run).unwrap();
    let events = dir.with(|journal| journal.events()).unwrap();
    let powers: Vec<f64> = events
        .iter()
        .filter(|e| e.kind == "light-read")
        .map(|e| serde_json::from_str::<serde_json::Value>(&e.json).unwrap()["power_w"].as_f64().unwrap())
        .collect();
    assert!(!powers.is_empty() && powers.iter().all(|p| (p / 1e-3 - 1.0).abs() < 0.01), "{powers:?}");
}

/// The safe part of the conformance suite, on every device of the bench, through the same table and file as a run.
#[test]
fn every_device_of_the_bench_keeps_its_contract() {
    let lab = lab();
    let instrument = text(&lab.instrument());
    for name in ["tilt", "filter_wheel", "shutter", "light_monitor", "monochromator", "ccd", "ingaas"] {
        let file = lab.path("conform.json");
        let said = lab.goniod(&["conform", name, "--yes", "--instrument", &instrument, "--report", &text(&file)]);
        assert_eq!(said.code, 0, "{name}: {}{}", said.out, said.err);
        assert!(said.out.contains(&format!("{name} (")) && said.out.contains(") conforms"), "{name}: {}", said.out);
        let report: serde_json::Value = serde_json::from_str(&std::fs::read_to_string(&file).unwrap()).unwrap();
        let findings = report["findings"].as_array().unwrap();
        assert!(findings.len() == 8 && findings.iter().all(|f| f["verdict"] != "failed"), "{name}: {report}");
        assert_eq!(findings[0]["verdict"], "passed", "{report}");
    }
}

#[test]
fn nothing_moves_without_consent_and_a_device_that_fails_says_where() {
    let lab = lab();
    let instrument = text(&lab.instrument());
    let conform = |name: &str, more: &[&str]| {
        lab.goniod(&[&["conform", name, "--instrument", &instrument, "--json"], more].concat())
    };
    let said = conform("tilt", &[]);
    assert_eq!(said.code, 10, "{}{}", said.out, said.err);
    assert!(said.err.contains("nothing was sent") && said.err.contains("--yes"), "{}", said.err);
    assert_eq!(conform("light_monitor", &[]).code, 0, "what does not move needs no consent");
    assert_eq!(conform("tiltt", &["--yes"]).code, 2);
    let said = conform("tilt", &["--yes", "--report", "/no/such/folder/report.json"]);
    assert_eq!(said.code, 6, "{}", said.err);
    assert!(said.err.contains("/no/such/folder/report.json"), "{}", said.err);
    // Another device stands on its port.
    let lab = Lab::small();
    lab.edit("instrument.sim.toml", &[("port = \"sim:monochromator\"", "port = \"sim:light-monitor\"")], true);
    let instrument = text(&lab.instrument());
    let said = lab.goniod(&["conform", "monochromator", "--instrument", &instrument, "--json", "--yes"]);
    assert_eq!(said.code, 5, "{}{}", said.out, said.err);
    let report = said.json();
    assert_eq!((&report["conforms"], &report["findings"][0]["verdict"]), (&false.into(), &"failed".into()), "{report}");
    assert!(report["findings"][0]["note"].as_str().unwrap().contains("no exact answer to ECHO"), "{report}");
}
