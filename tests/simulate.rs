//! Promise: a bench served by `goniod simulate` differs from hardware in nothing but the paths. Two processes, real time:
//! serial ports in a folder, cameras over GigE Vision, faults by the side channel; the oracle judges the files.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stderr)]

#[cfg(feature = "aravis")]
mod common;

#[cfg(feature = "aravis")]
mod served {
    use crate::common::{Lab, Said, text};
    use goniod::front::oracle::Files;
    use serde_json::Value;
    use std::io::{BufRead, BufReader, Read};
    use std::path::PathBuf;
    use std::process::{Child, ChildStdout, Command, Stdio};
    use std::time::Duration;

    /// One direction, one band a camera, a short ladder.
    const SCAN: &str = r#"
name = "served"
[sample]
thickness_mm = 4.0
[incidence]
directions = [[0, 180]]
sides = ["transmission-front"]
[bands]
use = ["f5", "nir1"]
[exposure]
policy = "ladder"
ratio = 8.0
shortest_s = 0.004
longest_s = 0.3
[products]
formats = ["hdf5"]
"#;

    /// Looks that a condition gets before the test gives up; at ten a second two minutes.
    const LOOKS: usize = 1200;

    /// A simulation under way.
    struct Simulation<'a> {
        lab: &'a Lab,
        folder: PathBuf,
        child: Child,
        out: BufReader<ChildStdout>,
    }

    // === impl Simulation ===

    impl<'a> Simulation<'a> {
        /// Starts it and waits until it says that it is ready.
        fn start(lab: &'a Lab, folder: &str, more: &[&str]) -> Simulation<'a> {
            let (folder, instrument) = (lab.path(folder), text(&lab.instrument()));
            let place = text(&folder);
            let mut args = vec!["simulate", "--instrument", &instrument, "--folder", &place];
            args.extend(more);
            let mut child = lab.command(&args).stdout(Stdio::piped()).spawn().unwrap();
            let mut out = BufReader::new(child.stdout.take().unwrap());
            let mut ready = String::new();
            out.read_line(&mut ready).unwrap();
            assert!(ready.contains("is served: goniod run SCAN --instrument"), "{ready}");
            Simulation { lab, folder, child, out }
        }

        fn instrument(&self) -> String {
            text(&self.folder.join("instrument.toml"))
        }

        /// A command of ours with its instrument file.
        fn goniod(&self, args: &[&str]) -> Said {
            let instrument = self.instrument();
            let mut all = args.to_vec();
            all.extend(["--instrument", &instrument]);
            self.lab.goniod(&all)
        }

        /// A line to the side channel, as the client says it.
        fn say(&self, line: &str) -> Said {
            self.lab.goniod(&["simulate", "fault", &text(&self.folder), line, "--json"])
        }

        /// A line that must be carried out.
        fn ask(&self, line: &str) -> Value {
            let said = self.say(line);
            assert_eq!(said.code, 0, "{line}: {}{}", said.out, said.err);
            said.json()["answer"].clone()
        }

        /// Looks at the truth again and again.
        fn until(&self, what: &str, holds: impl Fn(&Value) -> bool) {
            let mut last = Value::Null;
            for _ in 0..LOOKS {
                last = self.ask("pose");
                if holds(&last) {
                    return;
                }
                std::thread::sleep(Duration::from_millis(100));
            }
            panic!("in vain waited until {what}: {last}");
        }

        /// Ends it by a signal and proves that nothing but the instrument file is left.
        fn end(mut self, signal: &str) {
            assert!(Command::new("kill").args([signal, &self.child.id().to_string()]).status().unwrap().success());
            let mut rest = String::new();
            self.out.read_to_string(&mut rest).unwrap();
            assert_eq!(self.child.wait().unwrap().code(), Some(0), "{rest}");
            let left: Vec<_> = std::fs::read_dir(&self.folder).unwrap().map(|e| e.unwrap().file_name()).collect();
            assert_eq!(left, ["instrument.toml"], "{rest}");
        }
    }

    impl Drop for Simulation<'_> {
        fn drop(&mut self) {
            // Over already, unless the test failed.
            let _ = self.child.kill();
            let _ = self.child.wait();
        }
    }

    /// A small lab with brisk stages and a light monitor.
    fn lab() -> Lab {
        let lab = Lab::small();
        let monitor =
            "[light_monitor]\ndriver = \"newport-1830c\"\nport = \"sim:light-monitor\"\nwavelength_nm = 550.0\n\n";
        let brisk = [
            ("speed_deg_per_s = 20.0", "speed_deg_per_s = 120.0"),
            ("per_s2 = 40.0", "per_s2 = 1000.0"),
            ("settle_s = 0.2", "settle_s = 0.02"),
            ("[camera.ccd]\n", &format!("{monitor}[camera.ccd]\n")),
        ];
        lab.edit("instrument.sim.toml", &brisk, true);
        lab
    }

    #[test]
    fn a_run_against_a_served_bench_recovers_from_faults_and_labels_every_frame_truly() {
        let lab = lab();
        let scan = text(&lab.scan("served.toml", SCAN));
        let bench = Simulation::start(&lab, "bench", &["--seed", "11"]);

        let checked = bench.goniod(&["check", &scan]);
        assert_eq!((checked.code, checked.err.as_str()), (0, ""), "{}", checked.out);
        let listed = bench.goniod(&["device", "list", "--json"]);
        assert_eq!(listed.code, 0, "{}{}", listed.out, listed.err);
        let listed = listed.json();
        let devices = listed["devices"].as_array().unwrap();
        let of = |name: &str| devices.iter().find(|d| d["name"] == name).unwrap()["identity"]["serial"].clone();
        assert_eq!(devices.len(), 9, "{listed}");
        assert_eq!((of("tilt"), of("ccd"), of("ingaas")), ("50001".into(), "CCD-0001".into(), "INGAAS-0001".into()));

        let instrument = bench.instrument();
        let args = ["run", &scan, "--instrument", &instrument, "--runs", "runs", "--no-products", "--json"];
        let run = lab.command(&args).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        // The references are behind us when the holder has turned to a pose of the scan.
        bench.until("the shutter opens", |pose| pose["shutter_open"] == true);
        bench.ask("holder cut 3");
        bench.ask("ccd freeze 4");
        bench.ask("ingaas truncated");
        let said = run.wait_with_output().unwrap();
        let (out, err) = (String::from_utf8_lossy(&said.stdout), String::from_utf8_lossy(&said.stderr));
        assert_eq!(said.status.code(), Some(0), "{out}{err}");
        let ran: Value = serde_json::from_str(&out).unwrap();
        assert_eq!((&ran["missing"], &ran["planned"], &ran["safe"]), (&0.into(), &0.into(), &true.into()), "{ran}");

        let counters = bench.ask("counters");
        assert_eq!(counters["waiting"].as_array().unwrap().len(), 0, "every fault happened: {counters}");
        let files = Files::open(&lab.path(ran["run"].as_str().unwrap())).unwrap();
        let verdict = files.judge().unwrap();
        assert!(verdict.is_clean() && verdict.mislabelled.is_empty(), "{:?}", verdict.lines());
        assert_eq!(verdict.stored, files.document.plan.steps.len());
        let pose = bench.ask("pose");
        assert_eq!(pose["shutter_open"], false, "the bench was made safe: {pose}");
        eprintln!("{} frames in {} s, {}; {}", verdict.stored, ran["took_s"], verdict.lines()[0], counters["cameras"]);
        bench.end("-TERM");
    }

    #[test]
    fn two_benches_with_other_devices_stand_side_by_side_and_refuse_a_third() {
        let lab = lab();
        let first = Simulation::start(&lab, "first", &[]);
        lab.edit(
            "instrument.sim.toml",
            &[
                ("\"zaber-ascii\"", "\"newport-esp301\""),
                ("speed_deg_per_s = 120.0", "speed_deg_per_s = 20.0"),
                ("acceleration_deg_per_s2 = 1000.0", "acceleration_deg_per_s2 = 40.0"),
                ("device = 2\naxis = 1", "device = 1\naxis = 2"),
                ("device = 3\naxis = 1", "device = 1\naxis = 3"),
                ("\"thorlabs-sc10\"", "\"lcus-relay\""),
            ],
            true,
        );
        let second = Simulation::start(&lab, "second", &[]);
        for bench in [&first, &second] {
            let listed = bench.goniod(&["device", "list"]);
            assert_eq!(listed.code, 0, "{}{}", listed.out, listed.err);
        }
        // Each has its own stages, and its own words for what goes wrong with them.
        let stood = first.ask("pose")["spin_deg"].clone();
        let moved = second.goniod(&["device", "move", "spin", "30", "--json"]);
        assert_eq!(moved.json()["state"], "30°", "{}{}", moved.out, moved.err);
        assert!((second.ask("pose")["spin_deg"].as_f64().unwrap() - 30.0).abs() < 0.01);
        assert_eq!(first.ask("pose")["spin_deg"], stood);
        second.ask("holder emergency-stop 1");
        let said = first.say("holder emergency-stop 1");
        assert_eq!(said.code, 2, "{}", said.out);
        assert!(said.err.contains("no fault `emergency-stop`; it has `busy`"), "{}", said.err);

        let taken = lab.goniod(&["simulate", "--instrument", &text(&lab.instrument()), "--folder", "first"]);
        assert_eq!(taken.code, 10, "{}{}", taken.out, taken.err);
        assert!(taken.err.contains("belongs to a simulation that runs"), "{}", taken.err);
        first.end("-INT");
        second.end("-TERM");
        let nobody = lab.goniod(&["simulate", "fault", "first", "pose"]);
        assert_eq!(nobody.code, 10);
        assert!(nobody.err.contains("no simulation answers at first/faults.sock"), "{}", nobody.err);
    }

    /// The vendor's own library drives the holder of a served bench and finds what the side channel says is true.
    #[test]
    fn the_vendors_library_drives_the_holder_of_a_served_bench() {
        let root = crate::common::root();
        let python = std::env::var_os("GONIOD_PYTHON").map_or(root.join(".venv/bin/python"), PathBuf::from);
        let probe = Command::new(&python).args(["-c", "import zaber_motion"]).output();
        if !probe.is_ok_and(|o| o.status.success()) {
            eprintln!("\n*** SKIPPED: no Python with zaber_motion (tests/peers/requirements.txt) ***\n");
            return;
        }
        let lab = lab();
        let bench = Simulation::start(&lab, "bench", &[]);
        let mut command = Command::new(python);
        command.arg("-P").arg(root.join("tests/peers/zaber_vendor.py")).arg(bench.folder.join("holder"));
        let out = command.output().unwrap();
        let found = String::from_utf8_lossy(&out.stdout);
        assert!(out.status.success(), "{found}{}", String::from_utf8_lossy(&out.stderr));
        for part in [r#""homed": true"#, r#""position": 12800.0"#, r#""serial": "50001", "parked": true"#] {
            assert!(found.contains(part), "{part}: {found}");
        }
        assert!(bench.ask("pose")["tilt_deg"].as_f64().unwrap() > 0.0);
        bench.end("-TERM");
    }
}
