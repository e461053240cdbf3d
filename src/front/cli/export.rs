//! `goniod export RUN --format …`: one product again.

use super::exit::Exit;
use super::input::open_run;
use super::output::{Failure, Outcome, Output};
use crate::products::make::{Product, make};
use serde::Serialize;
use std::path::PathBuf;

/// Arguments.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The run directory.
    run: PathBuf,
    /// What to write.
    #[arg(long, value_enum)]
    format: Format,
}

#[derive(Debug, Clone, Copy, clap::ValueEnum)]
enum Format {
    /// WINDOW / Radiance Klems matrix, Visible and Solar.
    KlemsXml,
    /// One Klems matrix a band.
    KlemsXmlBands,
    /// HDF5 with NeXus layout.
    Hdf5,
}

#[derive(Serialize)]
struct Exported {
    files: Vec<PathBuf>,
}

/// Runs the command.
pub fn run(args: Args, output: &Output) -> Outcome {
    let run = open_run(&args.run)?;
    let product = match args.format {
        Format::KlemsXml => Product::KlemsXml,
        Format::KlemsXmlBands => Product::KlemsXmlBands,
        Format::Hdf5 => Product::Hdf5,
    };
    let made = make(&run, &[product]).map_err(|e| Failure::new(Exit::Storage, e.to_string()))?;
    output.result(Exit::Done, &Exported { files: made.files.clone() }, || {
        made.files.iter().map(|f| f.display().to_string()).collect::<Vec<_>>().join("\n")
    })
}
