//! Promise: the command line stays as it is told: help texts are golden files, `--json` is one document in every case.
//!
//! After a wanted change: `GONIOD_GOLDEN=write cargo test --test cli`, then look at the difference.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stderr)]

mod common;

use common::{Lab, root, text};
use std::fs;

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
