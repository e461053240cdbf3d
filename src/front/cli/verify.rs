//! `goniod verify RUN`: proves a run directory whole.

use super::exit::Exit;
use super::output::{Outcome, Output};
use crate::archive::verify::{Finding, verify};
use crate::front::night::storage;
use serde::Serialize;
use std::path::PathBuf;

/// Arguments.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The run directory.
    run: PathBuf,
}

#[derive(Serialize)]
struct Verified {
    run: PathBuf,
    sound: bool,
    whole: bool,
    sealed: bool,
    steps: u32,
    stored: u32,
    missing: u32,
    planned: u32,
    findings: Vec<Finding>,
    leftovers: Vec<String>,
    unproven: Vec<String>,
}

/// Runs the command.
pub fn run(args: Args, output: &Output) -> Outcome {
    let found = verify(&args.run).map_err(storage)?;
    let exit = match (found.sound(), found.whole()) {
        (false, _) => Exit::Damaged,
        (true, true) if found.summary.missing == 0 => Exit::Done,
        (true, _) => Exit::Incomplete,
    };
    let verified = Verified {
        run: args.run,
        sound: found.sound(),
        whole: found.whole(),
        sealed: found.sealed,
        steps: found.steps,
        stored: found.summary.stored,
        missing: found.summary.missing,
        planned: found.summary.planned,
        findings: found.findings,
        leftovers: found.leftovers,
        unproven: found.unproven,
    };
    output.result(exit, &verified, || text(&verified))
}

fn text(v: &Verified) -> String {
    let mut lines: Vec<String> = v.findings.iter().map(words).collect();
    lines.extend(v.leftovers.iter().map(|l| format!("left over from a write that was cut short, harmless: {l}")));
    lines.extend(v.unproven.iter().map(|what| format!("cannot be proven: {what}")));
    let state = if v.sound { "sound" } else { "DAMAGED" };
    let sealed = if v.sealed { "sealed" } else { "not closed" };
    lines.push(format!(
        "{}: {state}, {sealed}; {} planned exposures = {} stored + {} missing + {} not done",
        v.run.display(),
        v.steps,
        v.stored,
        v.missing,
        v.planned
    ));
    lines.join("\n")
}

fn words(finding: &Finding) -> String {
    match finding {
        Finding::FileChanged(file) => format!("{file}: not the bytes that the run was made with"),
        Finding::FileMissing(file) => format!("{file}: gone"),
        Finding::ChunkMissing(step) => format!("step {step}: its frame is gone from the store"),
        Finding::ChunkChanged(step) => format!("step {step}: its frame has other bytes than were written"),
        Finding::ChunkUnreadable(step) => format!("step {step}: its frame cannot be decoded"),
        Finding::ChunkWithoutRow(file) => format!("{file}: no journal row speaks of this file"),
        Finding::RowsDisagree(step) => format!("step {step}: the journal's rows contradict each other"),
        Finding::JournalDamaged(what) => format!("journal.sqlite: {what}"),
        Finding::ProductChanged(file) => format!("{file}: not the bytes that were written; make the products again"),
        Finding::ProductMissing(file) => format!("{file}: gone; make the products again"),
        Finding::SealBroken(what) => format!("seal: {what}"),
    }
}
