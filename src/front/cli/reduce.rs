//! `goniod reduce RUN`: all products again from the raw frames.

use super::exit::Exit;
use super::input::open_run;
use super::output::{Failure, Outcome, Output};
use crate::products::make::make_all;
use std::path::PathBuf;

/// Arguments.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The run directory.
    run: PathBuf,
}

/// Runs the command.
pub fn run(args: Args, output: &Output) -> Outcome {
    let run = open_run(&args.run)?;
    let made = make_all(&run).map_err(|e| Failure::new(Exit::Storage, e.to_string()))?;
    output.result(Exit::Done, &made, || {
        let files = made.files.iter().map(|f| f.display().to_string());
        made.headline
            .iter()
            .chain(&made.not_made)
            .cloned()
            .chain([String::new()])
            .chain(files)
            .collect::<Vec<_>>()
            .join("\n")
    })
}
