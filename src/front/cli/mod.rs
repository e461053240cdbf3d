//! The command line: one file a command, the same shape in each: `Args`, `run(args, output) -> Outcome`.

pub mod exit;
pub mod output;

mod check;
mod conform;
mod daemon;
mod device;
mod export;
pub mod input;
mod plan;
mod progress;
mod queue;
mod reduce;
mod rehearse;
mod report;
mod resume;
mod run;
mod safe;
mod serve;
mod simulate;
mod status;
mod verbs;
mod verify;
mod watch;

pub use run::exit_of_bench;

use clap::{Parser, Subcommand};
use output::{Outcome, Output};
use std::process::ExitCode;

/// Runs a video-goniophotometer and gives back the BSDF of the sample with its uncertainty.
#[derive(Debug, Parser)]
#[command(name = "goniod", version, about, max_term_width = 100)]
struct Cli {
    /// One JSON document on standard output instead of text.
    #[arg(long, global = true)]
    json: bool,
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Name every mistake in a scan and its instrument, with file, line and column.
    Check(check::Args),
    /// Show the steps of a scan and the forecast of time and disk.
    Plan(plan::Args),
    /// Measure, in the foreground.
    Run(run::Args),
    /// Go on with a run at the exposure where it ended, was stopped or was cut short.
    Resume(resume::Args),
    /// Measure on the simulated bench in virtual time: a night in seconds.
    Rehearse(rehearse::Args),
    /// Serve the simulated bench to other programs: ports in a folder, cameras on loopback, faults by a socket.
    Simulate(simulate::Args),
    /// Make all products again from the raw frames of a run.
    Reduce(reduce::Args),
    /// Write one product of a run again.
    Export(export::Args),
    /// Write the HTML report and the plots of a run again.
    Report(report::Args),
    /// Prove a run directory whole.
    Verify(verify::Args),
    /// Tell what the runs are doing or how they ended.
    Status(status::Args),
    /// Look at, move or read one device by hand.
    Device(device::Args),
    /// Try whether one device keeps its contract; asks before anything moves.
    Conform(conform::Args),
    /// Make the bench safe, past everything else; the queue is then held.
    Safe(safe::Args),
    /// Serve the queue: the daemon.
    Serve(serve::Args),
    /// Tell the daemon what to measure.
    Queue(queue::Args),
    /// Follow what the daemon does.
    Watch(watch::Args),
    /// Close the shutter after the exposure under way and wait.
    Pause(verbs::PauseArgs),
    /// End the run after the exposure under way, safely; the queue is then held.
    Stop(verbs::Args),
    /// End the run now, safely; the queue is then held.
    Abort(verbs::Args),
}

/// Parses the command line, runs the command and gives its exit code.
pub fn main() -> ExitCode {
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        Err(error) => return refused(&error),
    };
    init_logging();
    let output = Output { json: cli.json };
    let outcome = dispatch(cli.command, &output);
    match outcome {
        Ok(exit) => exit.into(),
        Err(failure) => output.failure(&failure).into(),
    }
}

/// What clap has to say: help and version as they are, a wrong command line as a failure like any other.
fn refused(error: &clap::Error) -> ExitCode {
    let json = std::env::args_os().any(|argument| argument == "--json");
    if json && error.use_stderr() {
        let failure = output::Failure::new(exit::Exit::Usage, error.to_string().trim_end());
        return Output { json }.failure(&failure).into();
    }
    // Nobody can be told that standard error is closed.
    let _ = error.print();
    ExitCode::from(u8::try_from(error.exit_code()).unwrap_or(exit::Exit::Usage.code()))
}

fn dispatch(command: Command, output: &Output) -> Outcome {
    match command {
        Command::Check(args) => check::run(args, output),
        Command::Plan(args) => plan::run(args, output),
        Command::Run(args) => run::run(args, output),
        Command::Resume(args) => resume::run(args, output),
        Command::Rehearse(args) => rehearse::run(args, output),
        Command::Simulate(args) => simulate::run(args, output),
        Command::Reduce(args) => reduce::run(args, output),
        Command::Export(args) => export::run(args, output),
        Command::Report(args) => report::run(args, output),
        Command::Verify(args) => verify::run(args, output),
        Command::Status(args) => status::run(args, output),
        Command::Device(args) => device::run(args, output),
        Command::Conform(args) => conform::run(args, output),
        Command::Safe(args) => safe::run(args, output),
        Command::Serve(args) => serve::run(args, output),
        Command::Queue(args) => queue::run(args, output),
        Command::Watch(args) => watch::run(args, output),
        Command::Pause(args) => verbs::pause(&args, output),
        Command::Stop(args) => verbs::give("stop", &args.daemon, output),
        Command::Abort(args) => verbs::give("abort", &args.daemon, output),
    }
}

/// Log lines go to standard error; `GONIOD_LOG` filters them (default: warnings).
fn init_logging() {
    let filter = tracing_subscriber::EnvFilter::try_from_env("GONIOD_LOG")
        .unwrap_or_else(|_| tracing_subscriber::EnvFilter::new("warn"));
    let _ = tracing_subscriber::fmt().with_env_filter(filter).with_writer(std::io::stderr).try_init();
}
