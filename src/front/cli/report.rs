//! `goniod report RUN`: the HTML report and its plots again.

use super::exit::Exit;
use super::input::open_run;
use super::output::{Failure, Outcome, Output};
use crate::products::make::{Product, make};
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
    let made =
        make(&run, &[Product::Plots, Product::Report]).map_err(|e| Failure::new(Exit::Storage, e.to_string()))?;
    output
        .result(Exit::Done, &made, || made.files.iter().map(|f| f.display().to_string()).collect::<Vec<_>>().join("\n"))
}
