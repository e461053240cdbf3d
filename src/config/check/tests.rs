//! Every fault of the files is told, at its place, and the shipped files have none.
#![allow(clippy::unwrap_used, clippy::expect_used)]

use super::*;
use crate::config::testing::config_dir;
use std::fs;
use tempfile::TempDir;

/// A copy of the shipped configuration that a test may change.
struct Bench {
    dir: TempDir,
    options: Options,
}

impl Bench {
    fn new() -> Bench {
        let dir = tempfile::tempdir().unwrap();
        copy(&config_dir(), dir.path());
        // The bench's own files are read by the simulator, whose tests hold them; here they only have to be there.
        for name in [
            "bench.toml",
            "samples/rough_glass.toml",
            "samples/lambspec_tree.toml",
            "samples/prism42.toml",
            "samples/clear_glazing.toml",
        ] {
            let path = dir.path().join("sim").join(name);
            if !path.exists() {
                fs::create_dir_all(path.parent().unwrap()).unwrap();
                fs::write(path, "").unwrap();
            }
        }
        let drivers = [
            "zaber-ascii",
            "thorlabs-fw212c",
            "thorlabs-sc10",
            "sim-ccd",
            "sim-ingaas",
            "v4l2",
            "aravis",
            "newport-1830c",
            "spectral-cm110",
        ];
        let drivers = drivers.map(str::to_owned).to_vec();
        Bench { dir, options: Options { drivers, today: jiff::civil::date(2026, 6, 1) } }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.dir.path().join(name)
    }

    /// Replaces text in a file; the text must be there.
    fn change(&self, name: &str, from: &str, to: &str) -> &Bench {
        let text = fs::read_to_string(self.path(name)).unwrap();
        assert!(text.contains(from), "{name} has no {from:?}");
        fs::write(self.path(name), text.replacen(from, to, 1)).unwrap();
        self
    }

    fn instrument(&self, from: &str, to: &str) -> &Bench {
        self.change("instrument.sim.toml", from, to)
    }

    fn scan(&self, from: &str, to: &str) -> &Bench {
        self.change("scans/demo.toml", from, to)
    }

    fn check(&self) -> Result<Checked, ConfigError> {
        check(&self.path("scans/demo.toml"), &self.path("instrument.sim.toml"), &self.options)
    }

    /// The only error, which must stand at `key` and say all words.
    fn only(&self, key: &str, words: &[&str]) {
        let issues = self.check().expect_err(key).issues().to_vec();
        let errors: Vec<&Issue> = issues.iter().filter(|i| i.severity == Severity::Error).collect();
        assert_eq!(errors.len(), 1, "{key}: {}", ConfigError::Faulty { issues: issues.clone() });
        let error = errors[0];
        assert_eq!(error.key, key, "{error}");
        for word in words {
            assert!(error.message.contains(word), "{error} lacks {word:?}");
        }
        let leaf = key.rsplit('.').next().unwrap().split('[').next().unwrap();
        let text = fs::read_to_string(&error.path).unwrap();
        assert_eq!(text.lines().nth(error.line - 1), Some(error.source_line.as_str()));
        assert!(error.source_line.contains(leaf) || error.source_line.starts_with('[') || key == "response", "{error}");
    }
}

fn copy(from: &Path, to: &Path) {
    fs::create_dir_all(to).unwrap();
    for entry in fs::read_dir(from).unwrap().map(Result::unwrap) {
        let target = to.join(entry.file_name());
        if entry.file_type().unwrap().is_dir() {
            copy(&entry.path(), &target);
        } else {
            fs::copy(entry.path(), target).unwrap();
        }
    }
}

#[test]
fn every_shipped_scan_fits_the_simulated_instrument() {
    let bench = Bench::new();
    let mut count = 0;
    for entry in fs::read_dir(config_dir().join("scans")).unwrap().map(Result::unwrap) {
        let scan = bench.path("scans").join(entry.file_name());
        let checked =
            check(&scan, &bench.path("instrument.sim.toml"), &bench.options).unwrap_or_else(|e| panic!("{e}"));
        assert!(checked.warnings.is_empty(), "{:?}", checked.warnings);
        count += 1;
    }
    assert_eq!(count, 5);
}

#[test]
fn a_checked_scan_has_everything_a_run_must_keep() {
    let checked = Bench::new().check().unwrap();
    let names: Vec<&str> = checked.files.iter().map(|f| f.name.as_str()).collect();
    for name in [
        "instrument.sim.toml",
        "scans/demo.toml",
        "calibration/ccd.sim.toml",
        "spectra/camera/ccd_rgb_asr_model.csv",
        "sim/samples/rough_glass.toml",
    ] {
        assert!(names.contains(&name), "{names:?} lacks {name}");
    }
    assert_eq!(checked.files.len(), 14);
    for file in &checked.files {
        assert_eq!(file.bytes, fs::read(&file.path).unwrap_or_else(|_| file.bytes.clone()));
        assert_eq!(file.sha256.len(), 64);
    }
    assert_eq!(checked.calibrations["ingaas"].geometry.reserved_rows, 16);
    assert_eq!(checked.spectra.responsivity["ccd"].names, ["r", "g", "b"]);
    assert_eq!(checked.spectra.lamp.range_nm(), (300.0, 1700.0));
}

/// The example is the real instrument of nobody: all it lacks is a calibration of its own cameras.
#[test]
fn the_example_instrument_wants_only_its_own_calibrations() {
    let bench = Bench::new();
    let error =
        check(&bench.path("scans/demo.toml"), &bench.path("instrument.example.toml"), &bench.options).unwrap_err();
    let errors: Vec<&Issue> = error.issues().iter().filter(|i| i.severity == Severity::Error).collect();
    assert_eq!(errors.len(), 2, "{error}");
    assert!(errors.iter().all(|i| i.key == "camera_serial"), "{error}");
}

/// A line put under the head of a table, or instead of one, makes one fault at its key.
#[test]
fn tables_of_camera_drivers_are_checked() {
    let bench = || {
        let bench = Bench::new();
        bench
            .instrument("driver = \"sim-ccd\"\nport = \"sim:ccd\"", "driver = \"v4l2\"\nport = \"/dev/video0\"")
            .instrument("driver = \"sim-ingaas\"\nport = \"sim:ingaas\"", "driver = \"aravis\"\nport = \"127.0.0.9\"")
            .instrument("[optics]", "[camera.ccd.v4l2]\n[camera.ingaas.aravis]\n[optics]");
        bench
    };
    assert!(bench().check().is_ok(), "real cameras may stand beside a simulated bench");
    let ccd = |line: &str, key: &str, words: &[&str]| {
        bench().instrument("[camera.ccd.v4l2]", &format!("[camera.ccd.v4l2]\n{line}")).only(key, words);
    };
    ccd("sum_frames = 300", "camera.ccd.v4l2.sum_frames", &["from 1 to 257"]);
    ccd("longest_frame_s = 10.0", "camera.ccd.longest_s", &["120", "10 s", "raise `sum_frames`"]);
    ccd("gain = { id = 1, scale = 1 }\nhas_gain = false", "camera.ccd.v4l2.gain", &["`has_gain` is false"]);
    ccd("exposure = { id = 1, scale = 0 }", "camera.ccd.v4l2.exposure.scale", &["one raw step"]);
    ccd("controls = [{ id = 1, value = 0.5 }]", "camera.ccd.v4l2.controls[0].value", &["whole numbers"]);
    ccd("buffers = 1", "camera.ccd.v4l2.buffers", &["from 2 to 32"]);
    let ingaas = |line: &str, key: &str, words: &[&str]| {
        bench().instrument("[camera.ingaas.aravis]", &format!("[camera.ingaas.aravis]\n{line}")).only(key, words);
    };
    ingaas("packet_size_bytes = 90000", "camera.ingaas.aravis.packet_size_bytes", &["from 576 to 16260"]);
    ingaas("frame_rate_hz = 30.0", "camera.ingaas.aravis.frame_rate_hz", &["software trigger", "free-run"]);
    ingaas("trigger = \"free-run\"\nframe_rate_hz = 0", "camera.ingaas.aravis.frame_rate_hz", &["above 0"]);
    ingaas("heartbeat_s = 0.1", "camera.ingaas.aravis.heartbeat_s", &["from 0.5 to 65"]);
    ingaas("trigger = \"sofware\"", "camera.ingaas.aravis.trigger", &["did you mean \"software\""]);
    ingaas("packet_size = 1500", "camera.ingaas.aravis.packet_size", &["packet_size_bytes"]);
    bench()
        .instrument("format = \"mono12\"", "format = \"mono14\"")
        .instrument("[camera.ingaas.aravis]", "[camera.ingaas.aravis]\npacking = \"mono12p\"")
        .only("camera.ingaas.aravis.packing", &["Mono14", "write \"words\""]);
}

#[test]
fn cameras_must_fit_their_driver_and_the_bench() {
    Bench::new()
        .instrument("[optics]", "[camera.ccd.aravis]\n[optics]")
        .only("camera.ccd.aravis", &["the camera's driver is \"sim-ccd\"", "take the table out"]);
    Bench::new()
        .instrument("\"sim-ingaas\"", "\"aravis\"")
        .only("camera.ingaas.port", &["\"sim:ingaas\"", "drives real cameras"]);
    Bench::new()
        .instrument("driver = \"sim-ccd\"\nport = \"sim:ccd\"", "driver = \"v4l2\"\nport = \"video0\"")
        .only("camera.ccd.port", &["needs a device path"]);
    for format in ["rgb8", "yuyv8"] {
        let bench = Bench::new();
        bench.instrument("driver = \"sim-ccd\"\nport = \"sim:ccd\"", "driver = \"v4l2\"\nport = \"/dev/video0\"");
        let checked = bench.instrument("\"bayer-rggb8\"", &format!("\"{format}\"")).check().unwrap();
        assert!(checked.warnings.iter().any(|w| w.key == "camera.ccd.format"), "{:?}", checked.warnings);
        bench.instrument("\"v4l2\"", "\"aravis\"").only("camera.ccd.format", &["driver \"v4l2\" only"]);
    }
    let bench = Bench::new();
    let lacking = bench.options.drivers.iter().filter(|d| *d != "sim-ccd").cloned().collect();
    let bench = Bench { options: Options { drivers: lacking, ..bench.options.clone() }, ..bench };
    bench.only("camera.ccd.driver", &["this build lacks", "--features sim"]);
}

#[test]
fn exposures_must_be_possible_for_every_camera_used() {
    Bench::new()
        .instrument("longest_s = 120.0", "longest_s = 2.0")
        .only("exposure.longest_s", &["32 s", "`ccd`", "2 or less"]);
    Bench::new().scan("shortest_s = 0.007", "shortest_s = 1e-7").only("exposure.shortest_s", &["0.000001"]);
    Bench::new()
        .instrument("shortest_s = 0.000001", "shortest_s = 0.01")
        .only("exposure.shortest_s", &["7.813 ms", "`ccd`", "0.01 or more"]);
    Bench::new().scan("ratio = 16.0", "ratio = 1.0").only("exposure.ratio", &["above 1"]);
    Bench::new().scan("ratio = 16.0", "ratio = nan").only("exposure.ratio", &["above 1"]);
    Bench::new().scan("longest_s = 32.0", "longest_s = 0.0001").only("exposure.longest_s", &["no integration time"]);
    Bench::new().scan("ratio = 16.0", "ratio = 1.01").only("exposure.ratio", &["64"]);
}

#[test]
fn bands_slots_and_cameras_must_fit() {
    Bench::new().scan("\"f3\"", "\"f33\"").only("bands.use[2]", &["f33", "`f1`"]);
    Bench::new().scan("\"f3\"", "\"dark\"").only("bands.use[2]", &["dark"]);
    Bench::new().scan("\"f3\"", "\"f2\"").only("bands.use[2]", &["second time"]);
    Bench::new()
        .instrument("[filter_wheel.slot.12]", "[filter_wheel.slot.13]")
        .only("filter_wheel.slot.13", &["1 to 12"]);
    Bench::new()
        .instrument("[filter_wheel.slot.12]", "[filter_wheel.slot.012]")
        .only("filter_wheel.slot.012", &["1 to 12"]);
    Bench::new().instrument("band = \"dark\"", "band = \"f1\"\ninterval_nm = [380, 500]\ncamera = \"ccd\"\nglasses = [{ glass = \"GG400\", thickness_mm = 1 }]").only("filter_wheel.slot.12.band", &["slot 1"]);
    Bench::new()
        .instrument("glasses = [{ glass = \"RG830\", thickness_mm = 2.0 }]", "")
        .only("filter_wheel.slot.8.glasses", &["without a filter"]);
    Bench::new()
        .instrument("\"RG830\"", "\"RG838\"")
        .only("filter_wheel.slot.8.glasses[0].glass", &["did you mean \"RG830\""]);
    Bench::new()
        .instrument("camera = \"ingaas\"", "camera = \"nir\"")
        .only("filter_wheel.slot.9.camera", &["`ccd`, `ingaas`"]);
    Bench::new().instrument("[380.0, 500.0]", "[500.0, 380.0]").only("filter_wheel.slot.1.interval_nm", &["rise"]);
}

#[test]
fn directions_must_be_within_reach_and_once() {
    Bench::new().scan("[82.5, 180]", "[90, 180]").only("incidence.directions[8][0]", &["below 90"]);
    Bench::new().scan("[82.5, 180]", "[82.5, inf]").only("incidence.directions[8][1]", &["-360 to 360"]);
    Bench::new().scan("[10, 180]", "[0, 90]").only("incidence.directions[1]", &["direction 1 again"]);
    let bench = Bench::new();
    let error = bench.instrument("max_deg = 182.0", "max_deg = 175.0").check().unwrap_err();
    let keys: Vec<&str> = error.issues().iter().map(|i| i.key.as_str()).collect();
    assert_eq!(keys, ["reference.transmission.theta_deg", "incidence.directions[0]", "reference"], "{error}");
    let message = &error.issues()[1].message;
    for word in ["1 of 9", "transmission-front", "tilt", "180 degrees", "from -2 to 175"] {
        assert!(message.contains(word), "{message}");
    }
    Bench::new()
        .scan("directions =", "basis = \"klems-full\"\ndirections =")
        .only("incidence.directions", &["keep one"]);
    Bench::new().scan("directions =", "# directions =").only("incidence", &["`basis`"]);
    Bench::new()
        .scan("sides = [\"transmission-front\", \"reflection-front\"]", "sides = []")
        .only("incidence.sides", &["empty"]);
    Bench::new().scan("\"reflection-front\"", "\"transmission-front\"").only("incidence.sides[1]", &["twice"]);
}

#[test]
fn a_holder_without_changer_cannot_turn_the_sample_or_show_diffusers() {
    let bench = Bench::new();
    let text = fs::read_to_string(bench.path("instrument.sim.toml")).unwrap();
    let (start, end) = (text.find("[holder.changer]").unwrap(), text.find("[filter_wheel]").unwrap());
    let text = format!("{}{}", &text[..start], &text[end..]).replace("\"changer\", ", "");
    let (start, end) = (text.find("[reference.reflection]").unwrap(), text.find("[safe_state]").unwrap());
    fs::write(bench.path("instrument.sim.toml"), format!("{}[reference]\n{}", &text[..start], &text[end..])).unwrap();
    let error = bench.check().unwrap_err();
    let keys: Vec<&str> = error.issues().iter().map(|i| i.key.as_str()).collect();
    assert_eq!(keys, ["incidence.sides[1]", "reference", "reference"], "{error}");
    bench.scan("every_directions = 6", "mode = \"irradiance\"");
    bench.scan(", \"reflection-front\"", "");
    bench.check().unwrap();
    bench.instrument("irradiance_uw_per_cm2 = 75.0", "").only("reference.mode", &["irradiance_uw_per_cm2"]);
}

#[test]
fn calibrations_must_be_of_the_camera_and_of_the_day() {
    let ccd = "calibration/ccd.sim.toml";
    let change = |from: &str, to: &str| {
        let bench = Bench::new();
        bench.change(ccd, from, to);
        bench
    };
    change("CCD-0001", "CCD-0002").only("camera_serial", &["CCD-0002", "CCD-0001"]);
    let bench = change("2035-12-31", "2026-05-31");
    let warnings = bench.check().unwrap().warnings;
    assert_eq!((warnings.len(), warnings[0].key.as_str()), (1, "valid_until"));
    change("2035-12-31", "2025-01-01").only("valid_until", &["before"]);
    change("\"2035-12-31\"", "2035-12-31").only("valid_until", &["\"2026-01-31\""]);
    change("centre_y_px = 527.5", "centre_y_px = 490.0").only("geometry.centre_y_px", &["top", "16 reserved"]);
    change("centre_x_px = 695.5", "centre_x_px = 1000.0").only("geometry.centre_x_px", &["right"]);
    change("c = 1.5177818e7", "c = 1.4468e7").only("response.convention", &["0.3085", "as-printed"]);
    change("c = 1.5177818e7", "").only("response.c", &["missing"]);
    change("[-0.10, -0.05]", "[-0.90, -0.15]").only("vignetting.even_coefficients", &["above 0"]);
    change("ccd_rgb_asr_model", "ingaas_asr_model").only("responsivity.file", &["\"r\", \"g\", \"b\""]);
    change("ccd_rgb_asr_model", "no_such").only("responsivity.file", &["not there"]);
}

#[test]
fn devices_must_be_known_and_safe() {
    Bench::new().instrument("zaber-ascii", "zaber-asci").only("holder.driver", &["did you mean \"zaber-ascii\""]);
    Bench::new().instrument("\"sim:shutter\"", "\"sim:holder\"").only("holder.port", &["shutter uses already"]);
    Bench::new()
        .instrument("\"shutter\", \"cameras\"", "\"shuter\", \"shutter\", \"cameras\"")
        .only("safe_state.order[0]", &["did you mean \"shutter\""]);
    Bench::new().instrument("\"shutter\", \"cameras\"", "\"cameras\"").only("safe_state.order", &["beam must be shut"]);
    Bench::new()
        .instrument("speed_deg_per_s = 20.0", "speed_deg_per_s = -20.0")
        .only("holder.tilt.speed_deg_per_s", &["from 0.001 to 1000"]);
    Bench::new().instrument("min_deg = -2.0", "min_deg = 200.0").check().unwrap_err();
    Bench::new().instrument("device = 2", "device = 1").only("holder.spin.device", &["holder.tilt"]);
    Bench::new()
        .instrument("sample_flipped_deg = 180.0", "sample_flipped_deg = 0.0")
        .only("holder.changer.sample_flipped_deg", &["same place"]);
    Bench::new().instrument("sample_flipped_deg = 180.0", "sample_flipped_deg = 280.0").check().unwrap_err();
    Bench::new().instrument("eccentricity = 0.3", "eccentricity = 1.0").only("optics.eccentricity", &["below 1"]);
    Bench::new().instrument("hmi_model_300_1700.csv", "").only("lamp.spectrum", &["folder"]);
    Bench::new().instrument("theta_deg = 0.0", "theta_deg = 90.0").check().unwrap_err();
    Bench::new().scan("simulated = ", "# simulated = ").only("sample.simulated", &["simulated"]);
}

#[test]
fn spectra_that_are_none_are_refused_at_the_key_that_names_them() {
    let bench = Bench::new();
    fs::write(bench.path("spectra/source/hmi_model_300_1700.csv"), "wavelength_nm,value\n300,1\n290,1\n").unwrap();
    bench.only("lamp.spectrum", &["line 3"]);
    let bench = Bench::new();
    fs::write(bench.path("spectra/reference/opal_flat50.csv"), "wavelength_nm,value\n300,1\n400,1.5\n").unwrap();
    bench.only("reference.transmission.spectrum", &["from 0 to 1"]);
}

#[test]
fn all_faults_of_all_files_are_told_at_once_in_order() {
    let bench = Bench::new();
    bench.scan("ratio = 16.0", "ratio = 0.5").scan("\"f3\"", "\"f33\"").change(
        "calibration/ccd.sim.toml",
        "CCD-0001",
        "X",
    );
    bench.instrument("eccentricity = 0.3", "eccentricity = 3.0").instrument("\"RG830\"", "\"XY1\"");
    let error = bench.check().unwrap_err();
    let keys: Vec<&str> = error.issues().iter().map(|i| i.key.as_str()).collect();
    assert_eq!(
        keys,
        [
            "camera_serial",
            "filter_wheel.slot.8.glasses[0].glass",
            "optics.eccentricity",
            "bands.use[2]",
            "exposure.ratio"
        ]
    );
    // Two files that cannot even be read as structs are told together too.
    bench.scan("ratio =", "ratoi =").instrument("half_axis_mm", "half_axis_cm");
    let error = bench.check().unwrap_err();
    assert_eq!(error.issues().len(), 2, "{error}");
    let missing =
        check(&bench.path("scans/none.toml"), &bench.path("instrument.sim.toml"), &bench.options).unwrap_err();
    assert!(matches!(missing, ConfigError::NotFound { role: "scan", .. }));
}

#[test]
fn the_lamp_that_is_in_names_a_file_and_its_hours_need_it() {
    let lamp = |lines: &str| {
        let bench = Bench::new();
        bench.instrument("[holder]\n", &format!("{lines}\n[holder]\n"));
        bench
    };
    for serial in ["", "../a", ".a", "a b", "a/b", "ä"] {
        lamp(&format!("serial = \"{serial}\"")).only("lamp.serial", &["letters, digits"]);
    }
    lamp(&format!("serial = \"{}\"", "a".repeat(65))).only("lamp.serial", &["at most 64"]);
    lamp("serial = \"A-1\"\nhours_at_start = -1.0").only("lamp.hours_at_start", &["from 0"]);
    let warnings = |lines: &str| lamp(lines).check().unwrap().warnings;
    assert!(warnings("serial = \"HMI_0.4-2\"\nrated_hours = 750.0\nhours_at_start = 3.0").is_empty());
    let [hours, restrike] = &warnings("rated_hours = 750.0\nrestrike_s = 600.0")[..] else { panic!("two") };
    assert!(hours.message.contains("`lamp.serial`"), "{hours}");
    assert!(restrike.message.contains("`lamp.warm_up_s`"), "{restrike}");
}
