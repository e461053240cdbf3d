//! `goniod simulate`: the simulated bench for other programs, in real time until a signal ends it; `simulate fault` is
//! the client of its side channel.

use super::exit::Exit;
use super::output::{Failure, Outcome, Output};
use serde::Serialize;
use std::io::{BufRead, BufReader, Write};
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// How long a running simulation may take for an answer.
const PATIENCE: Duration = Duration::from_secs(10);
/// Name of the side channel's socket.
const SOCKET: &str = "faults.sock";

/// Arguments.
#[derive(Debug, clap::Args)]
#[command(args_conflicts_with_subcommands = true)]
pub struct Args {
    #[command(subcommand)]
    verb: Option<Verb>,
    /// The instrument file; its ports are not used [default: $GONIOD_INSTRUMENT, config/instrument.toml, /etc/goniod/instrument.toml].
    #[arg(long, value_name = "FILE")]
    instrument: Option<PathBuf>,
    /// Sample in the holder [default: samples/clear_glazing.toml beside the bench's description].
    #[arg(long, value_name = "FILE")]
    sample: Option<PathBuf>,
    /// Seed of the bench [default: that of the instrument's [simulation]].
    #[arg(long)]
    seed: Option<u64>,
    /// Folder that gets the ports, `instrument.toml` and the socket of the side channel.
    #[arg(long, value_name = "DIR", default_value = "simulated")]
    folder: PathBuf,
}

#[derive(Debug, clap::Subcommand)]
enum Verb {
    /// Let a fault happen on a bench that is served, or ask it for its `pose`, `faults` or `counters`.
    Fault {
        /// Folder of the simulation.
        folder: PathBuf,
        /// `PART FAULT [NUMBER]`, such as `holder silence 3`; or `pose`, `faults`, `counters`.
        #[arg(required = true, allow_negative_numbers = true)]
        line: Vec<String>,
    },
}

/// What a fault or question gave back.
#[derive(Debug, Serialize)]
struct Answered {
    answer: serde_json::Value,
}

/// Runs the command.
pub fn run(args: Args, output: &Output) -> Outcome {
    match &args.verb {
        Some(Verb::Fault { folder, line }) => {
            let answer = ask(folder, &line.join(" "))?;
            let text = serde_json::to_string_pretty(&answer).unwrap_or_default();
            output.result(Exit::Done, &Answered { answer }, || text)
        }
        None => serve(&args, output),
    }
}

/// One line to the side channel and its answer.
fn ask(folder: &Path, line: &str) -> Result<serde_json::Value, Failure> {
    let socket = folder.join(SOCKET);
    let nobody = |e: std::io::Error| {
        let message = format!(
            "no simulation answers at {}: {e}; start one with `goniod simulate --folder {}`",
            socket.display(),
            folder.display()
        );
        Failure::new(Exit::Refused, message)
    };
    let mut stream = UnixStream::connect(&socket).map_err(nobody)?;
    stream.set_read_timeout(Some(PATIENCE)).map_err(nobody)?;
    stream.set_write_timeout(Some(PATIENCE)).map_err(nobody)?;
    stream.write_all(format!("{}\n", line.replace('\n', " ")).as_bytes()).map_err(nobody)?;
    let mut reply = String::new();
    BufReader::new(stream).read_line(&mut reply).map_err(nobody)?;
    let mut document: serde_json::Value = serde_json::from_str(&reply)
        .map_err(|e| Failure::new(Exit::Failed, format!("{} answers what cannot be read: {e}", socket.display())))?;
    match document.get("error").and_then(|e| e.as_str()) {
        Some(sentence) => Err(Failure::new(Exit::Usage, sentence)),
        None => Ok(document.get_mut("ok").map(serde_json::Value::take).unwrap_or_default()),
    }
}

#[cfg(not(feature = "sim"))]
fn serve(args: &Args, _: &Output) -> Outcome {
    // Nobody reads them in such a build.
    let _ = (&args.instrument, &args.sample, args.seed, &args.folder);
    let lacks = crate::front::bench::BenchError::Lacks { what: "simulated bench", feature: "sim" };
    Err(Failure::new(Exit::BadInput, lacks.to_string()))
}

#[cfg(feature = "sim")]
use served::serve;

/// The bench itself.
#[cfg(feature = "sim")]
mod served {
    use super::*;
    use crate::config::check::check_devices;
    use crate::front::bench::served::{Request, Standing, exit_of, serve as stand};
    use crate::front::cli::input::{bad_input, check_options, instrument_path};
    use crate::front::cli::run::no_runtime;
    use goniod_drivers::clock::Clock;
    use std::collections::BTreeMap;
    use tokio::signal::unix::{SignalKind, signal};

    /// What was served.
    #[derive(Debug, Serialize)]
    struct Simulated {
        instrument: PathBuf,
        cameras: BTreeMap<String, String>,
    }

    /// Serves until SIGINT or SIGTERM.
    pub fn serve(args: &Args, output: &Output) -> Outcome {
        let path = instrument_path(args.instrument.as_deref())?;
        let instrument = check_devices(&path, check_options(Clock::system()).today).map_err(bad_input)?;
        let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build().map_err(no_runtime)?;
        let request = Request {
            base: path.parent().unwrap_or(Path::new("")),
            folder: &args.folder,
            sample: args.sample.as_deref(),
            seed: args.seed,
        };
        let simulated = runtime.block_on(async {
            let no_signal = |e| Failure::new(Exit::Failed, format!("SIGINT and SIGTERM cannot be listened to: {e}"));
            let mut interrupt = signal(SignalKind::interrupt()).map_err(no_signal)?;
            let mut terminate = signal(SignalKind::terminate()).map_err(no_signal)?;
            let standing = stand(&instrument, &request, Clock::system());
            let standing = standing.map_err(|e| Failure::new(exit_of(&e), e.to_string()))?;
            warn_of_drivers(output);
            output.say(&text(&instrument.name, &standing));
            tokio::select! {
                _ = interrupt.recv() => {}
                _ = terminate.recv() => {}
            }
            Ok::<_, Failure>(Simulated { instrument: standing.instrument.clone(), cameras: standing.cameras().clone() })
        })?;
        output.result(Exit::Done, &simulated, || "ended; the ports are gone".to_owned())
    }

    fn warn_of_drivers(output: &Output) {
        if goniod_drivers::table::lookup("aravis").is_err() {
            output.warn("the cameras need the driver `aravis`, which this build lacks; run a goniod built with `--features aravis` against them");
        }
    }

    fn text(name: &str, standing: &Standing) -> String {
        let instrument = standing.instrument.display();
        let mut lines = vec![format!("{name} is served: goniod run SCAN --instrument {instrument}")];
        lines.extend(standing.ports().iter().map(|port| format!("  {}", port.display())));
        lines.extend(standing.cameras().iter().map(|(name, address)| format!("  camera {name} at {address}")));
        lines.extend(standing.usb_hints().iter().map(|hint| format!("  {hint}")));
        let folder = standing.instrument.parent().unwrap_or(Path::new("")).display();
        lines.push(format!("  faults: goniod simulate fault {folder} faults"));
        lines.join("\n")
    }
}
