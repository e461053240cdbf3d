//! `goniod rehearse SCAN`: the same run on the simulated bench in virtual time.

use super::input::{ScanArgs, bad_input, moment};
use super::output::{Outcome, Output};
use super::run::{finish, measure, no_runtime};
use crate::front::bench::{FaultMix, Rehearsal, open_simulated};
use goniod_drivers::clock::Clock;
use std::path::PathBuf;

/// Arguments.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(flatten)]
    scan: ScanArgs,
    /// Folder for the run directory.
    #[arg(long, value_name = "DIR", default_value = "runs/rehearsal")]
    runs: PathBuf,
    /// Seed of the bench [default: that of the instrument's [simulation]].
    #[arg(long)]
    seed: Option<u64>,
    /// Sample in the bench [default: `simulated` of the scan].
    #[arg(long, value_name = "FILE")]
    sample: Option<PathBuf>,
    /// What goes wrong on the way, drawn from the seed; the oracle then judges every label.
    #[arg(long, value_name = "MIX", value_enum, default_value_t)]
    faults: FaultMix,
    /// When the rehearsed night begins.
    #[arg(long, value_name = "MOMENT", default_value = "2026-01-01T18:00:00Z")]
    start: String,
    /// Measure only; products can be made later with `goniod reduce`.
    #[arg(long)]
    no_products: bool,
}

/// Runs the command.
pub fn run(args: Args, output: &Output) -> Outcome {
    let mut checked = args.scan.check(output)?;
    if let Some(sample) = &args.sample {
        checked.lay_sample(sample).map_err(bad_input)?;
    }
    let start = moment(&args.start)?;
    let runtime =
        tokio::runtime::Builder::new_current_thread().enable_all().start_paused(true).build().map_err(no_runtime)?;
    let rehearsal = Rehearsal { seed: args.seed, faults: args.faults };
    let open = |clock| open_simulated(&checked, &rehearsal, clock);
    let work = measure(&checked, &args.runs, || Clock::starting_at(start), open, (None, output));
    let (ran, exit) = runtime.block_on(work)?;
    finish(ran, exit, !args.no_products, output)
}
