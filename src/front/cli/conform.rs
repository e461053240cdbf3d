//! `goniod conform DEVICE`: the safe part of the conformance suite on one device of the instrument file, real or a twin.

use super::device::{Bench, OfInstrument, take};
use super::exit::Exit;
use super::output::{Failure, Outcome, Output};
use crate::front::bench::by_hand::Entry;
use goniod_drivers::conformance::{Finding, Verdict, check};
use serde::Serialize;
use std::io::{BufRead, IsTerminal, Write};
use std::path::PathBuf;

/// Arguments.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Name in the instrument file, such as `tilt`, `filter_wheel` or `ccd`.
    name: String,
    /// Write the report as JSON into this file too.
    #[arg(long, value_name = "FILE")]
    report: Option<PathBuf>,
    /// Move the device without asking first.
    #[arg(long)]
    yes: bool,
    #[command(flatten)]
    of: OfInstrument,
}

/// What the device did.
#[derive(Debug, Serialize)]
struct Report {
    device: String,
    driver: String,
    port: String,
    conforms: bool,
    findings: Vec<Finding>,
}

/// Runs the command.
pub fn run(args: Args, output: &Output) -> Outcome {
    let bench = Bench::of(&args.of, "goniod conform")?;
    bench.with(async |instrument, hands, clock| {
        let (entry, mut subject) = take(instrument, hands, &args.name)?;
        if subject.moves() && !args.yes {
            consent(&entry, output)?;
        }
        let findings = check(&mut subject, clock, &mut |finding| output.say(&line(finding))).await;
        let report = Report {
            conforms: !findings.iter().any(|finding| finding.verdict.failed()),
            device: entry.name,
            driver: entry.driver,
            port: entry.port,
            findings,
        };
        if let Some(file) = &args.report {
            write(&report, file)?;
        }
        let exit = if report.conforms { Exit::Done } else { Exit::Device };
        output.result(exit, &report, || report.text())
    })
}

/// The words of an operator before anything moves.
fn consent(entry: &Entry, output: &Output) -> Result<(), Failure> {
    let what = format!(
        "{} ({} at {}) will be moved within its limits, brought back and made safe",
        entry.name, entry.driver, entry.port
    );
    let refused = |why: &str| Failure::new(Exit::Refused, format!("{what}; {why}"));
    if output.json || !std::io::stdin().is_terminal() {
        return Err(refused("nothing was sent: write `--yes` where nobody can be asked"));
    }
    output.say(&format!("{what}. Is that safe now? Type yes:"));
    let _ = std::io::stdout().flush();
    let mut answer = String::new();
    match std::io::stdin().lock().read_line(&mut answer) {
        Ok(_) if answer.trim() == "yes" => Ok(()),
        _ => Err(refused("nothing was sent: that was no `yes`")),
    }
}

fn write(report: &Report, file: &std::path::Path) -> Result<(), Failure> {
    let storage = |e: &dyn std::fmt::Display| {
        let what =
            format!("{}: the report cannot be written ({e}); name a file in a folder that exists", file.display());
        Failure::new(Exit::Storage, what)
    };
    let text = serde_json::to_string_pretty(report).map_err(|e| storage(&e))?;
    std::fs::write(file, text + "\n").map_err(|e| storage(&e))
}

/// One check for people.
fn line(finding: &Finding) -> String {
    let word = match finding.verdict {
        Verdict::Passed(_) => "passed",
        Verdict::NotApplicable(_) => "n/a",
        Verdict::Failed(_) => "FAILED",
    };
    format!("{:<14} {word:<7} {}", finding.check.name, finding.verdict.note())
}

// === impl Report ===

impl Report {
    fn text(&self) -> String {
        let word = if self.conforms { "conforms" } else { "does not conform" };
        format!("{} ({} at {}) {word}", self.device, self.driver, self.port)
    }
}
