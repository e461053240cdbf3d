//! Puts the twin of a driver's device behind a pseudo-terminal: `twin_pty DRIVER PATH`, until it is ended.
#![allow(clippy::print_stdout, clippy::print_stderr)]

use goniod_drivers::clock::Clock;
use goniod_sim::front::PtyPort;
use goniod_sim::twins::{DRIVERS, Twins, TwinsSpec};
use std::process::ExitCode;

/// Drivers of the parts that have one model.
const OTHERS: [&str; 2] = ["spectral-cm110", "newport-1830c"];

#[tokio::main]
async fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let known = [DRIVERS.concat(), OTHERS.to_vec()].concat();
    let [driver, path] = arguments.as_slice() else {
        eprintln!("usage: twin_pty DRIVER PATH; drivers: {}", known.join(", "));
        return ExitCode::from(2);
    };
    let mut drivers = ["zaber-ascii", "thorlabs-fw212c", "thorlabs-sc10"];
    let parts = DRIVERS.into_iter().chain([&OTHERS[..1], &OTHERS[1..]]);
    let Some(part) = parts.into_iter().position(|models| models.contains(&driver.as_str())) else {
        eprintln!("no twin for the driver {driver}; there are {}", known.join(", "));
        return ExitCode::from(2);
    };
    if let Some(place) = drivers.get_mut(part) {
        *place = driver;
    }
    let mut spec = TwinsSpec::with_serials("50001", "50002", "50003");
    spec.wheel.queues_input = true;
    if driver == "optec-ifw" {
        spec.wheel.places = 8;
    }
    let clock = Clock::system();
    let twins = match spec.with_drivers(drivers) {
        Ok(spec) => Twins::new(spec),
        Err(error) => {
            eprintln!("{error}");
            return ExitCode::from(2);
        }
    };
    let port = match part {
        0 => PtyPort::open(path, &twins.holder, clock),
        1 => PtyPort::open(path, &twins.wheel, clock),
        2 => PtyPort::open(path, &twins.shutter, clock),
        3 => PtyPort::open(path, &twins.monochromator, clock),
        _ => PtyPort::open(path, &twins.light_monitor, clock),
    };
    match port {
        Ok(port) => {
            println!("{driver} at {}", port.path().display());
            std::future::pending::<()>().await;
            ExitCode::SUCCESS
        }
        Err(error) => {
            eprintln!("no port at {path}: {error}");
            ExitCode::FAILURE
        }
    }
}
