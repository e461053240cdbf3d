//! Promise: bad input gets one clear sentence that says what, where, what is allowed and what to do, an exit code, and
//! leaves nothing half-written.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stderr)]

mod common;

use common::{Lab, Said, text};
use std::path::Path;
use std::process::Command;

const SCAN: &str = r#"name = "bad"
[sample]
thickness_mm = 4.0
simulated = "../sim/samples/rough_glass.toml"
[incidence]
directions = [[0, 180], [40, 180]]
sides = ["transmission-front"]
[bands]
use = ["f5"]
[exposure]
policy = "ladder"
ratio = 8.0
shortest_s = 0.01
longest_s = 0.64
[products]
formats = ["hdf5"]
"#;

const BAD_INPUT: i32 = 3;
const DEVICE: i32 = 5;
const STORAGE: i32 = 6;

/// Everything in the folder of runs, hidden files too.
fn runs(lab: &Lab) -> Vec<String> {
    let mut names: Vec<String> = std::fs::read_dir(lab.path("runs"))
        .map(|entries| entries.flatten().map(|e| e.file_name().to_string_lossy().into_owned()).collect())
        .unwrap_or_default();
    names.sort();
    names
}

/// A command on a scan, with nothing left behind when it fails.
fn command(lab: &Lab, command: &str, scan: &Path, more: &[&str]) -> Said {
    let before = runs(lab);
    let (scan, instrument) = (text(scan), text(&lab.instrument()));
    let mut args = vec![command, &scan];
    if !more.contains(&"--instrument") {
        args.extend(["--instrument", &instrument]);
    }
    if command != "check" && !more.contains(&"--runs") {
        args.extend(["--runs", "runs"]);
    }
    args.extend(more);
    let said = lab.goniod(&args);
    assert_eq!(runs(lab), before, "nothing half-written: {}", said.err);
    assert_eq!(said.out, "", "errors go to standard error");
    said
}

/// The code, every word of the message, and no more than `sentences` messages.
fn told(said: &Said, code: i32, words: &[&str]) {
    assert_eq!(said.code, code, "{}", said.err);
    for word in words {
        assert!(said.err.contains(word), "`{word}` is not in: {}", said.err);
    }
    let messages = said.err.lines().filter(|line| line.starts_with("goniod: ")).count();
    assert_eq!(messages, 1, "one sentence: {}", said.err);
    assert!(!said.err.contains("panicked") && !said.err.contains("Error {"), "{}", said.err);
}

/// A change in the scan file, told with its place by `check`, `rehearse` and `run` alike.
fn scan_is_refused(from: &str, to: &str, place: &str, words: &[&str]) {
    let lab = Lab::small();
    assert!(SCAN.contains(from));
    let scan = lab.scan("bad.toml", &SCAN.replacen(from, to, 1));
    let place = format!("bad.toml:{place}: error: ");
    for name in ["check", "rehearse", "run"] {
        let said = command(&lab, name, &scan, &[]);
        told(&said, BAD_INPUT, words);
        assert!(said.err.contains(&place), "{place} is not in: {}", said.err);
    }
}

/// A change in the instrument file, told with its place.
fn instrument_is_refused(pairs: &[(&str, &str)], file: &str, words: &[&str]) {
    let lab = Lab::small();
    lab.edit("instrument.sim.toml", pairs, true);
    let scan = lab.scan("bad.toml", SCAN);
    let said = command(&lab, "rehearse", &scan, &[]);
    assert_eq!(said.code, BAD_INPUT, "{}", said.err);
    let line = said.err.lines().find(|line| line.contains(file) && line.contains(": error: "));
    let line = line.unwrap_or_else(|| panic!("{file} is not in: {}", said.err));
    let numbers = line.split(file).nth(1).unwrap().split(':').skip(1).take(2);
    assert!(numbers.map(|n| n.parse::<usize>().unwrap()).all(|n| n > 0), "{line}");
    for word in words {
        assert!(line.contains(word), "`{word}` is not in: {line}");
    }
}

#[test]
fn files_that_are_not_there() {
    let lab = Lab::small();
    let said = command(&lab, "rehearse", &lab.path("config/scans/none.toml"), &[]);
    told(&said, BAD_INPUT, &["none.toml: there is no such scan file", "check the path"]);
    let scan = lab.scan("bad.toml", SCAN);
    let said = command(&lab, "rehearse", &scan, &["--instrument", "config/none.toml"]);
    told(&said, BAD_INPUT, &["config/none.toml: there is no such instrument file", "check the path"]);
    std::fs::remove_file(lab.path("config/calibration/ccd.sim.toml")).unwrap();
    let said = command(&lab, "rehearse", &scan, &[]);
    told(&said, BAD_INPUT, &["instrument.sim.toml:", "calibration", "ccd.sim.toml"]);
}

#[test]
fn no_instrument_is_named() {
    let lab = Lab::small();
    let scan = text(&lab.scan("bad.toml", SCAN));
    let said = lab.goniod(&["check", &scan]);
    if Path::new("/etc/goniod/instrument.toml").is_file() {
        eprintln!("*** SKIPPED: this machine has an instrument file ***");
        return;
    }
    told(&said, BAD_INPUT, &["no instrument file", "--instrument FILE", "$GONIOD_INSTRUMENT"]);
}

#[test]
fn a_syntax_error() {
    scan_is_refused("ratio = 8.0", "ratio = = 8.0", "12:9", &["this is not TOML", "correct the line", "ratio = = 8.0"]);
}

#[test]
fn a_wrong_unit() {
    scan_is_refused("longest_s", "longest_ms", "14:1", &["`longest_ms` is not a key", "write `longest_s`", "0.001"]);
}

#[test]
fn an_unknown_key() {
    scan_is_refused(
        "ratio",
        "speed = 1\nratio",
        "12:1",
        &["`speed` is not a key of [exposure]", "allowed are", "`ratio`"],
    );
}

#[test]
fn a_text_where_a_number_is_wanted() {
    scan_is_refused("8.0", "\"eight\"", "12:9", &["`exposure.ratio` is the text \"eight\"", "takes a number"]);
}

#[test]
fn a_direction_below_the_horizon() {
    scan_is_refused("[40, 180]", "[95, 180]", "6:26", &["is 95", "from 0 to below 90 degrees"]);
}

#[test]
fn a_side_that_does_not_exist() {
    scan_is_refused("transmission-front", "transmission-up", "7:10", &["did you mean \"transmission-back\"?"]);
}

#[test]
fn an_exposure_that_the_camera_cannot_do() {
    scan_is_refused(
        "longest_s = 0.64",
        "longest_s = 500.0",
        "14:13",
        &["camera `ccd`", "120 s at most", "write 120 or less"],
    );
}

#[test]
fn a_band_without_a_filter() {
    scan_is_refused("\"f5\"", "\"f9\"", "9:8", &["is \"f9\"", "does not have", "`f5`"]);
}

#[test]
fn a_direction_out_of_reach() {
    let lab = Lab::small();
    lab.edit("instrument.sim.toml", &[("max_deg = 182.0", "max_deg = 100.0")], true);
    let scan = lab.scan("bad.toml", SCAN);
    let said = command(&lab, "rehearse", &scan, &[]);
    assert_eq!(said.code, BAD_INPUT);
    for words in
        ["bad.toml:6:15: error: ", "the tilt axis would have to go to 180 degrees", "from -2 to 100", "take them out"]
    {
        assert!(said.err.contains(words), "`{words}` is not in: {}", said.err);
    }
}

#[test]
fn a_calibration_of_another_camera() {
    let words = ["belongs to camera \"CCD-0001\"", "is \"CCD-0009\"", "name the right file"];
    instrument_is_refused(&[("\"CCD-0001\"", "\"CCD-0009\"")], "ccd.sim.toml", &words);
}

#[test]
fn ports_half_simulated_and_half_real() {
    let words = ["`shutter.port` is \"/dev/ttyUSB9\"", "all hardware or all simulated", "make every port"];
    instrument_is_refused(&[("\"sim:shutter\"", "\"/dev/ttyUSB9\"")], "instrument.sim.toml", &words);
}

#[test]
fn an_axis_slower_than_any_stage() {
    for (key, is, most) in [("speed_deg_per_s", "20.0", 1000), ("acceleration_deg_per_s2", "40.0", 100_000)] {
        for slow in ["1e-15", "1e-10", "0.0009"] {
            let words = [format!("holder.tilt.{key}"), format!("must be from 0.001 to {most}")];
            let (from, to) = (format!("{key} = {is}"), format!("{key} = {slow}"));
            instrument_is_refused(&[(&from, &to)], "instrument.sim.toml", &words.each_ref().map(String::as_str));
        }
    }
}

#[test]
fn a_driver_that_does_not_exist() {
    let words = ["`camera.ccd.driver` is \"superccd\"", "known are", "`sim-ccd`"];
    instrument_is_refused(&[("\"sim-ccd\"", "\"superccd\"")], "instrument.sim.toml", &words);
}

/// Real ports and no simulation: the camera driver is refused first, the serial port by the driver itself.
#[tokio::test]
async fn hardware_that_is_not_there() {
    let lab = Lab::small();
    let real = [
        ("[simulation]\nbench = \"sim/bench.toml\"\nseed = 20090107\n", ""),
        ("\"sim:holder\"", "\"/dev/no-such-holder\""),
        ("\"sim:filter-wheel\"", "\"/dev/no-such-wheel\""),
        ("\"sim:shutter\"", "\"/dev/no-such-shutter\""),
        ("\"sim:monochromator\"", "\"/dev/no-such-monochromator\""),
        ("\"sim:ccd\"", "\"camera 1\""),
        ("\"sim:ingaas\"", "\"camera 2\""),
    ];
    lab.edit("instrument.sim.toml", &real, true);
    let scan = lab.scan("bad.toml", &SCAN.replace("simulated = \"../sim/samples/rough_glass.toml\"\n", ""));
    let said = command(&lab, "run", &scan, &[]);
    told(&said, BAD_INPUT, &["camera `ccd`", "driver `sim-ccd`", "simulated bench only", "rehearse the scan"]);
    let said = command(&lab, "rehearse", &scan, &[]);
    told(&said, BAD_INPUT, &["no [simulation] table", "add it", "--instrument"]);

    use goniod_drivers::clock::Clock;
    use goniod_drivers::devices::ShutterConfig;
    use goniod_drivers::table;
    use goniod_drivers::transport::SerialConnector;
    let clock = Clock::system();
    let connector = Box::new(SerialConnector::new("/dev/no-such-shutter", 9600, clock));
    let config = ShutterConfig { name: "shutter".to_owned(), settle: std::time::Duration::ZERO };
    let mut shutter = table::shutter("thorlabs-sc10", connector, config, clock).unwrap();
    let error = shutter.open().await.unwrap_err();
    let failure = goniod::front::bench::BenchError::Device(error.clone());
    assert_eq!(i32::from(goniod::front::cli::exit_of_bench(&failure).code()), DEVICE);
    for words in ["/dev/no-such-shutter is not there", "plug the adapter in", "`port` in the instrument file"] {
        assert!(failure.to_string().contains(words), "{failure}");
    }
}

#[test]
fn a_sample_and_a_moment_that_do_not_exist() {
    let lab = Lab::small();
    let scan = lab.scan("bad.toml", SCAN);
    let said = command(&lab, "rehearse", &scan, &["--sample", "none.toml"]);
    told(&said, BAD_INPUT, &["none.toml: there is no such sample file", "check the path"]);
    let said = command(&lab, "rehearse", &scan, &["--start", "tonight"]);
    told(&said, 2, &["`tonight` is not a moment", "2026-01-01T18:00:00Z"]);
}

#[test]
fn runs_folders_that_cannot_be_written() {
    let lab = Lab::small();
    let scan = lab.scan("bad.toml", SCAN);
    let under_a_file = ["cannot create the folder", "check the path and the rights"];
    let without_room = ["the run needs", "0.0 MB are free"];
    for (folder, words) in [("config/instrument.sim.toml/runs", under_a_file), ("/proc/goniod-runs", without_room)] {
        let said = command(&lab, "rehearse", &scan, &["--runs", folder]);
        told(&said, STORAGE, &[folder, words[0], words[1]]);
    }
}

#[test]
fn run_directories_that_are_none() {
    let lab = Lab::small();
    for name in ["reduce", "report", "verify"] {
        let said = lab.goniod(&[name, "config"]);
        told(&said, STORAGE, &["config: not a run directory that can be read"]);
        assert!(!lab.path("config/products").exists());
    }
    told(&lab.goniod(&["export", "none", "--format", "hdf5"]), STORAGE, &["none: "]);
    told(&lab.goniod(&["status", "--runs", "none"]), STORAGE, &["none: cannot be read"]);
}

/// What a rehearsal into a file system of `kib` KiB says, and what it leaves there; `None` where this machine does not
/// let a test mount one.
fn on_a_small_disk(lab: &Lab, kib: usize) -> Option<Said> {
    let scan = text(&lab.scan("bad.toml", SCAN));
    std::fs::create_dir_all(lab.path("disk")).unwrap();
    let script = format!(
        "mount -t tmpfs -o size={kib}k none disk || exit 99\n\
         {} rehearse {scan} --instrument {} --runs disk/runs --no-products\ncode=$?\n\
         echo left: $(ls -A disk/runs)\n\
         for run in disk/runs/*; do [ -d $run ] && {} verify $run >&2; done\nexit $code",
        env!("CARGO_BIN_EXE_goniod"),
        text(&lab.instrument()),
        env!("CARGO_BIN_EXE_goniod"),
    );
    let folder = lab.path("");
    let output = [["-m"].as_slice(), ["-rm"].as_slice()].into_iter().find_map(|flags| {
        let mut unshare = Command::new("unshare");
        let output = unshare.args(flags).args(["sh", "-c", &script]).current_dir(&folder).output().ok()?;
        (output.status.code() != Some(99) && output.status.code() != Some(1)).then_some(output)
    })?;
    Some(Said {
        code: output.status.code().unwrap_or(-1),
        out: String::from_utf8_lossy(&output.stdout).into_owned(),
        err: String::from_utf8_lossy(&output.stderr).into_owned(),
    })
}

#[test]
fn a_disk_too_small_for_the_night_is_refused_before_it_begins() {
    let lab = Lab::small();
    for kib in [200, 470] {
        let Some(said) = on_a_small_disk(&lab, kib) else {
            eprintln!("\n*** SKIPPED: no file system can be mounted here, so no full disk can be tested ***\n");
            return;
        };
        told(&said, STORAGE, &["the run needs", "are free", "free space there", "--runs"]);
        assert!(said.out.ends_with("left:\n"), "{}", said.out);
    }
}

/// The rows of a shipped table at the wavelengths that `keep` wants, changed by `change`.
fn retable(lab: &Lab, file: &str, keep: impl Fn(f64) -> bool, change: impl Fn(&str) -> String) {
    let path = lab.path("config/spectra").join(file);
    let old = std::fs::read_to_string(&path).unwrap();
    let wavelength = |row: &str| row.split(',').next().and_then(|cell| cell.parse::<f64>().ok());
    let rows = old.lines().filter(|row| wavelength(row).is_none_or(&keep));
    let new = rows.map(|row| if wavelength(row).is_some() { change(row) } else { row.to_owned() } + "\n");
    std::fs::write(&path, new.collect::<String>()).unwrap();
}

/// A table that ends within a band gives wrong numbers that nobody sees in the morning; it is told before the night.
#[test]
fn spectra_that_do_not_cover_what_the_bands_see() {
    let same = |row: &str| row.to_owned();
    type Damage<'a> = &'a dyn Fn(&Lab);
    let damages: [(Damage<'_>, &[&str]); 7] = [
        (
            &|lab| retable(lab, "reference/opal_flat50.csv", |nm| nm < 600.0, same),
            &[
                "reference.transmission.spectrum covers 300 to 595 nm",
                "% of what band `f5`, channel 0, sees lies outside",
            ],
        ),
        (
            &|lab| retable(lab, "reference/opal_flat50.csv", |_| true, |row| row.replace(",0.5", ",0.0")),
            &[
                "reference.transmission.spectrum is not above 0 where band `f5`",
                "correct the table or leave the band out",
            ],
        ),
        (
            &|lab| retable(lab, "mirror/aluminium_evaporated_best.csv", |nm| nm > 620.0, same),
            &["optics.mirror_reflectance covers 6", "band `f5`", "give a table that covers it"],
        ),
        (
            &|lab| retable(lab, "source/hmi_model_300_1700.csv", |nm| nm < 600.0, same),
            &["lamp.spectrum covers 300 to 595 nm, but band `f5` is 550 to 640 nm", "leave the band out"],
        ),
        (
            &|lab| retable(lab, "filter/coloured_glass_model_tau1mm.csv", |nm| nm < 600.0, same),
            &["the glass `OG570` covers", "band `f5` is 550 to 640 nm"],
        ),
        (
            &|lab| retable(lab, "camera/ccd_rgb_asr_model.csv", |nm| nm < 600.0, same),
            &["responsivity of camera `ccd`, channel 0, covers 360 to 595 nm", "band `f5` is 550 to 640 nm"],
        ),
        (
            &|lab| lab.edit("instrument.sim.toml", &[("[550.0, 640.0]", "[800.0, 900.0]")], true),
            &["band `f5`: only 0 % of what its camera sees", "interval_nm, 800 to 900 nm", "correct the interval"],
        ),
    ];
    for (damage, words) in damages {
        let lab = Lab::small();
        let scan = lab.scan("bad.toml", SCAN);
        damage(&lab);
        for name in ["check", "rehearse", "run"] {
            told(&command(&lab, name, &scan, &[]), BAD_INPUT, words);
        }
    }
    let lab = Lab::small();
    retable(&lab, "reference/spectralon99_model.csv", |nm| nm < 600.0, same);
    let said = lab.goniod(&["check", &text(&lab.scan("fine.toml", SCAN)), "--instrument", &text(&lab.instrument())]);
    assert_eq!(said.code, 0, "the scan does not need the reflecting diffuser: {}", said.err);
}
