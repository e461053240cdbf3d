//! `goniod check SCAN`: every mistake of scan, instrument and calibrations.

use super::exit::Exit;
use super::input::ScanArgs;
use super::output::{Outcome, Output};
use crate::front::night;
use serde::Serialize;

/// Arguments.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(flatten)]
    scan: ScanArgs,
}

#[derive(Serialize)]
struct Found {
    scan: String,
    instrument: String,
    warnings: Vec<String>,
    steps: usize,
}

/// Runs the command.
pub fn run(args: Args, output: &Output) -> Outcome {
    let checked = args.scan.check(output)?;
    let plan = night::plan(&checked)?;
    let lamp = night::lamp_warning(&checked.instrument, &plan, &checked.instrument.runs_dir);
    lamp.iter().for_each(|warning| output.warn(warning));
    let found = Found {
        scan: checked.scan.name.clone(),
        instrument: checked.instrument.name.clone(),
        warnings: checked.warnings.iter().map(ToString::to_string).chain(lamp).collect(),
        steps: plan.steps.len(),
    };
    output.result(Exit::Done, &found, || {
        format!(
            "{}: fits \"{}\", {} exposures; `goniod plan` tells how long they take.",
            args.scan.scan.display(),
            found.instrument,
            found.steps
        )
    })
}
