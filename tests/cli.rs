//! Promise: the command line stays as it is told: help texts are golden files, `--json` is one document in every case.
//!
//! After a wanted change: `GONIOD_GOLDEN=write cargo test --test cli`, then look at the difference.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stderr)]

mod common;

use common::{Lab, root, text};
use std::fs;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Stdio};
use std::time::Duration;

const COMMANDS: [&str; 20] = [
    "check", "plan", "run", "rehearse", "resume", "reduce", "export", "report", "verify", "status", "serve", "queue",
    "watch", "pause", "stop", "abort", "safe", "device", "conform", "simulate",
];

const SCAN: &str = r#"
name = "small"
[sample]
thickness_mm = 4.0
simulated = "../sim/samples/rough_glass.toml"
[incidence]
directions = [[0, 180]]
sides = ["transmission-front"]
[bands]
use = ["f5"]
[exposure]
policy = "ladder"
ratio = 8.0
shortest_s = 0.03
longest_s = 2.0
[products]
formats = ["hdf5"]
"#;

/// Compares with a golden file, or writes it where that was asked for.
fn golden(name: &str, found: &str) {
    let path = root().join("tests/golden").join(format!("{name}.txt"));
    if std::env::var_os("GONIOD_GOLDEN").is_some_and(|v| v == "write") {
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(&path, found).unwrap();
    }
    let expected = fs::read_to_string(&path).unwrap_or_default();
    assert_eq!(found, expected, "{} differs", path.display());
}

#[test]
fn the_help_is_what_it_was() {
    let lab = Lab::shipped();
    let said = lab.goniod(&["help"]);
    assert_eq!(said.code, 0);
    golden("goniod", &said.out);
    for command in COMMANDS {
        assert!(said.out.contains(&format!("  {command} ")), "{command} is not in the help");
        let help = lab.goniod(&["help", command]);
        assert_eq!(help.code, 0);
        golden(command, &help.out);
    }
}

/// Every command and every option of the help is in the manual, and the other way round.
#[test]
fn the_manual_names_every_command() {
    let manual = fs::read_to_string(root().join("docs/cli.md")).unwrap();
    for command in COMMANDS {
        assert!(manual.contains(&format!("| `{command} ")) || manual.contains(&format!("| `{command}`")), "{command}");
        let help = Lab::shipped().goniod(&["help", command]).out;
        let help = match *command == *"queue" {
            true => ["add", "list", "remove"].map(|c| Lab::shipped().goniod(&["queue", c, "--help"]).out).join(""),
            false => help,
        };
        let options = help.split_whitespace().filter(|word| word.starts_with("--") && !word.ends_with("help"));
        for option in options {
            assert!(manual.contains(option), "docs/cli.md does not tell {option} of `{command}`");
        }
    }
}

/// Runs a command with `--json` and gives its document, with outcome and exit code proven.
fn document(lab: &Lab, args: &[&str], outcome: &str) -> serde_json::Value {
    let mut all = args.to_vec();
    all.push("--json");
    let said = lab.goniod(&all);
    let document = said.json();
    assert_eq!(document["outcome"], outcome, "{args:?}: {}{}", said.out, said.err);
    assert_eq!(document["exit_code"].as_i64().unwrap(), i64::from(said.code), "{args:?}");
    let failed = ["bad-input", "storage", "usage", "device", "no-daemon"].contains(&outcome);
    assert_eq!(document["errors"].as_array().is_some_and(|e| !e.is_empty()), failed, "{args:?}: {}", said.out);
    document
}

#[test]
fn json_is_one_document_of_every_command_also_on_errors() {
    let lab = Lab::small();
    let (scan, instrument) = (text(&lab.scan("small.toml", SCAN)), text(&lab.instrument()));
    let with = |command: &'static str| vec![command, &scan, "--instrument", &instrument];
    document(&lab, &with("check"), "done");
    let plan = document(&lab, &with("plan"), "done");
    assert!(plan["forecast_total_s"].as_f64().unwrap() > 0.0);
    let mut rehearse = with("rehearse");
    rehearse.extend(["--runs", "runs"]);
    let ran = document(&lab, &rehearse, "done");
    let run = ran["run"].as_str().unwrap();
    assert_eq!(ran["missing"], 0);
    for (args, outcome) in [
        (vec!["verify", run], "done"),
        (vec!["reduce", run], "done"),
        (vec!["export", run, "--format", "hdf5"], "done"),
        (vec!["report", run], "done"),
        (vec!["status", "--runs", "runs"], "done"),
        (vec!["check", "none.toml", "--instrument", &instrument], "bad-input"),
        (vec!["plan", "none.toml", "--instrument", &instrument], "bad-input"),
        (vec!["run", "none.toml", "--instrument", &instrument], "bad-input"),
        (vec!["rehearse", "none.toml", "--instrument", &instrument], "bad-input"),
        (vec!["plan", &scan, "--instrument", &instrument, "--start", "tonight"], "usage"),
        (vec!["reduce", "none"], "storage"),
        (vec!["export", "none", "--format", "hdf5"], "storage"),
        (vec!["report", "none"], "storage"),
        (vec!["verify", "none"], "storage"),
        (vec!["status", "--runs", "none"], "storage"),
        (vec!["queue", "list", "--socket", "none"], "no-daemon"),
        (vec!["stop", "--socket", "none"], "no-daemon"),
        (vec!["safe", "--socket", "none"], "no-daemon"),
    ] {
        document(&lab, &args, outcome);
    }
    // The second rehearsal of the same night would be the same run.
    document(&lab, &rehearse, "storage");
}

/// A rehearsal long enough to meddle with, once it has stored `frames` frames, and its run directory.
fn under_way(lab: &Lab, runs: &str, frames: usize, more: &[&str]) -> (Child, PathBuf) {
    let long = SCAN.replace("[[0, 180]]", "[[0, 180], [15, 0], [30, 0], [45, 0], [60, 0]]");
    let scan = text(&lab.scan("long.toml", &long));
    let (instrument, runs) = (text(&lab.instrument()), lab.path(runs));
    let args = ["rehearse", &scan, "--instrument", &instrument, "--runs", &text(&runs)];
    let mut command = lab.command(&[&args[..], more].concat());
    let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    // A run appears under its name whole.
    let named = |e: &fs::DirEntry| !e.file_name().to_string_lossy().starts_with('.');
    let run = || {
        let folders = fs::read_dir(&runs).ok()?.flatten().filter(named).map(|e| e.path());
        folders.into_iter().find(|p| p.join("journal.sqlite").is_file())
    };
    let stored = |run: &Path| {
        let chunks = fs::read_dir(run.join("frames.zarr/ccd")).into_iter().flatten().flatten();
        chunks.filter(|entry| entry.file_name().to_string_lossy().starts_with("c.")).count()
    };
    while run().is_none_or(|run| stored(&run) < frames) {
        assert!(child.try_wait().unwrap().is_none(), "it ended too soon");
        std::thread::sleep(Duration::from_millis(2));
    }
    (child, run().unwrap())
}

#[test]
fn a_run_that_cannot_be_read_is_told_with_the_reason_and_not_left_out() {
    let lab = Lab::small();
    lab.rehearse(&lab.scan("small.toml", SCAN), "runs", &["--no-products"]);
    for (name, file) in [("20980101T000000Z-torn", "journal.sqlite"), ("20990101T000000Z-bare", "plan.toml")] {
        fs::create_dir(lab.path("runs").join(name)).unwrap();
        fs::write(lab.path("runs").join(name).join(file), "nothing of a run").unwrap();
    }
    fs::create_dir(lab.path("runs/notes")).unwrap();
    let told = document(&lab, &["status", "--runs", "runs"], "done");
    let runs = told["runs"].as_array().unwrap();
    let states: Vec<&str> = runs.iter().map(|r| r["state"].as_str().unwrap()).collect();
    assert_eq!(states, ["completed", "unreadable", "unreadable"], "a folder that is no run is none: {told}");
    assert!(runs[0].get("reason").is_none());
    let said = lab.goniod(&["status", "--runs", "runs"]);
    for (run, words) in [(&runs[1], "20980101T000000Z-torn"), (&runs[2], "there is no journal.sqlite in it")] {
        let reason = run["reason"].as_str().unwrap();
        assert!(reason.contains(words), "{reason}");
        let is_told = |line: &str| line.starts_with("unreadable ") && line.ends_with(reason);
        assert!(said.out.lines().any(is_told), "{reason}: {}", said.out);
    }
    let last = document(&lab, &["status", "--runs", "runs", "--last", "1"], "done");
    assert_eq!(last["runs"][0], runs[2]);
}

#[test]
fn a_damaged_run_does_not_stand_in_the_way_of_a_new_one_and_is_told() {
    let lab = Lab::small();
    lab.edit("instrument.sim.toml", &[("runs_dir = \"runs\"\n", "runs_dir = \"runs\"\nauto_resume = true\n")], true);
    let (mut child, run) = under_way(&lab, "runs", 4, &["--no-products"]);
    child.kill().unwrap();
    child.wait().unwrap();
    let log = run.join("journal.sqlite-wal");
    let mut bytes = fs::read(&log).unwrap();
    let half = bytes.len() / 2;
    bytes[half] ^= 1;
    fs::write(&log, &bytes).unwrap();
    let (scan, instrument) = (text(&lab.path("config/scans/long.toml")), text(&lab.instrument()));
    let mut command = lab.command(&["run", &scan, "--instrument", &instrument, "--no-products"]);
    let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let mut line = String::new();
    BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
    // A new run is begun; nobody waits for its end.
    child.kill().unwrap();
    let err = String::from_utf8(child.wait_with_output().unwrap().stderr).unwrap();
    let name = run.file_name().unwrap().to_str().unwrap();
    assert!(line.starts_with("run runs/") && !line.contains(name), "{line}{err}");
    let warning = err.lines().find(|line| line.starts_with("goniod: warning: ") && line.contains("not gone on with"));
    let warning = warning.unwrap_or_else(|| panic!("no warning in: {err}"));
    for words in [name, "damaged", "goniod resume RUN --accept-loss"] {
        assert!(warning.contains(words), "`{words}` is not in: {warning}");
    }
    assert_eq!(fs::read(&log).unwrap(), bytes, "it is left as it is");
}

/// Something in the place of the products: the night is told all the same.
#[test]
fn a_run_whose_products_cannot_be_made_is_told_with_what_to_do() {
    let lab = Lab::small();
    let ways: [(&str, &[&str]); 2] = [("runs", &[]), ("documents", &["--json"])];
    for (runs, json) in ways {
        let (child, run) = under_way(&lab, runs, 0, json);
        fs::write(run.join("products"), "in the way").unwrap();
        let output = child.wait_with_output().unwrap();
        let out = String::from_utf8(output.stdout).unwrap();
        let err = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(6), "{out}{err}");
        let advice = format!("`goniod reduce {}` makes them", run.display());
        assert!(err.contains("the products were NOT MADE: ") && err.contains(&advice), "{err}");
        if json.is_empty() {
            assert!(out.contains("\ncompleted: ") && out.contains("; bench safe\n"), "{out}");
            continue;
        }
        let document: serde_json::Value = serde_json::from_str(&out).unwrap();
        assert_eq!((&document["outcome"], &document["ending"]), (&"storage".into(), &"completed".into()), "{out}");
        assert!(document["safe"] == true && document["errors"][0].as_str().unwrap().contains(&advice), "{out}");
    }
}

/// What the command line itself refuses is one document too.
#[test]
fn json_is_one_document_of_a_wrong_command_line() {
    let lab = Lab::shipped();
    for args in
        [&["measure"][..], &["check"], &["export", "run", "--format", "pdf"], &["run", "a", "--speed", "9"], &[]]
    {
        let document = document(&lab, args, "usage");
        assert_eq!(document["exit_code"], 2);
    }
    let said = lab.goniod(&["measure"]);
    assert_eq!((said.code, said.out.as_str()), (2, ""));
    assert!(said.err.contains("unrecognized subcommand 'measure'"), "{}", said.err);
}
