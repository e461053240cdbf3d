//! `goniod plan SCAN`: the steps, the forecast of time by kind and of disk, the finish time.

use super::exit::Exit;
use super::input::{ScanArgs, moment};
use super::output::{Outcome, Output};
use crate::control::plan::{Forecast, Plan, Step, Subject, View};
use crate::front::{night, remaining};
use crate::products::night::duration;
use goniod_drivers::clock::Clock;
use serde::Serialize;
use std::fmt::Write;

/// Arguments.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(flatten)]
    scan: ScanArgs,
    /// List every step.
    #[arg(long)]
    steps: bool,
    /// Begin of the run, e.g. 2026-01-01T18:00:00Z [default: now].
    #[arg(long, value_name = "MOMENT")]
    start: Option<String>,
}

#[derive(Serialize)]
struct Shown<'a> {
    scan: &'a str,
    instrument: &'a str,
    plan_hash: &'a str,
    exposures: usize,
    views: usize,
    forecast: &'a Forecast,
    forecast_total_s: f64,
    start: String,
    finish: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    steps: Option<&'a [Step]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    view_list: Option<&'a [View]>,
}

/// Runs the command.
pub fn run(args: Args, output: &Output) -> Outcome {
    let checked = args.scan.check(output)?;
    let plan = night::plan(&checked)?;
    let start = args.start.as_deref().map_or(Ok(Clock::system().utc()), moment)?;
    let total_s = plan.forecast.total_s();
    let finish = remaining::after(start, total_s);
    let shown = Shown {
        scan: &checked.scan.name,
        instrument: &checked.instrument.name,
        plan_hash: &plan.hash,
        exposures: plan.steps.len(),
        views: plan.views.len(),
        forecast: &plan.forecast,
        forecast_total_s: total_s,
        start: night::stamp(start).to_string(),
        finish: night::stamp(finish).to_string(),
        steps: args.steps.then_some(&plan.steps[..]),
        view_list: args.steps.then_some(&plan.views[..]),
    };
    output.result(Exit::Done, &shown, || text(&shown, &plan, args.steps))
}

fn text(shown: &Shown<'_>, plan: &Plan, steps: bool) -> String {
    let mut out = String::new();
    let f = &plan.forecast;
    // Writing into a String cannot fail.
    let _ = writeln!(out, "{} on {}", shown.scan, shown.instrument);
    let _ = writeln!(out, "{} exposures in {} views, plan {}\n", shown.exposures, shown.views, short(&plan.hash));
    if steps {
        list(&mut out, plan);
    }
    for (what, seconds) in [
        ("begin and end", f.start_s),
        ("axes", f.moving_s),
        ("filters", f.filter_s),
        ("shutter", f.shutter_s),
        ("exposing", f.exposing_s),
        ("waiting for frames", f.overhead_s),
        ("all together", f.total_s()),
    ] {
        let _ = writeln!(out, "  {what:<20}{:>12}", duration(seconds));
    }
    let _ = writeln!(out, "\n  disk, before compression  {:.2} GB", f.raw_bytes as f64 / 1e9);
    let _ = write!(out, "  begins {}, done {}", shown.start, shown.finish);
    out
}

fn list(out: &mut String, plan: &Plan) {
    for step in &plan.steps {
        let Some(view) = plan.views.get(step.view as usize) else { continue };
        let _ = writeln!(out, "  {:>6}  {:<8} {:<44} {}", step.number, view.camera, words(view), step.exposure);
    }
    out.push('\n');
}

/// A view in words.
pub fn words(view: &View) -> String {
    let band = view.band.as_deref().unwrap_or("-");
    match &view.subject {
        Subject::Dark => format!("dark, set {}", view.repeat + 1),
        Subject::Reference { transmission: true } => format!("{band} transmitting reference {}", view.repeat + 1),
        Subject::Reference { transmission: false } => format!("{band} reflecting reference {}", view.repeat + 1),
        Subject::Sample { side, incident } => {
            let (theta, phi) = incident.degrees();
            format!("{band} {} {theta:.1}° {phi:.1}°", crate::products::context::side_words(*side))
        }
    }
}

fn short(hash: &str) -> &str {
    hash.get(..12).unwrap_or(hash)
}
