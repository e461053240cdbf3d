//! Promise: every driver of the table bears the whole suite on the twin of its device, and `docs/devices.md` says so.
//!
//! `GONIOD_FULL=1` tries 10,000 random commands a driver and 1,000,000 noisy exchanges over all;
//! `GONIOD_WRITE_DOCS=1` writes the page instead of comparing it.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout)]

mod cameras;
mod flawed;
mod page;

use goniod_drivers::clock::Clock;
use goniod_drivers::table::{DRIVERS, Driver, Make};
use goniod_sim::conformance::noise::Counts;
use goniod_sim::conformance::rig::{Unit, rig};
use goniod_sim::conformance::{Conduct, Effort, checks, conform};
use rayon::prelude::*;

/// Drivers that meet the whole suite.
fn wired() -> Vec<&'static Driver> {
    DRIVERS.iter().filter(|driver| !matches!(driver.make, Make::Camera(_))).collect()
}

/// The counts of a full run, and what fits into CI.
fn effort(drivers: u64) -> Effort {
    let full = std::env::var_os("GONIOD_FULL").is_some_and(|v| v == "1");
    let (commands, exchanges) = if full { (10_000, 1_000_000 / drivers + 1) } else { (1000, 8000) };
    Effort { commands, exchanges, seed: 1 }
}

fn paused() -> tokio::runtime::Runtime {
    tokio::runtime::Builder::new_current_thread().enable_time().start_paused(true).build().unwrap()
}

fn tried(driver: &'static Driver, effort: Effort) -> Conduct {
    let make = |unit: Unit| rig(driver, unit, Clock::system()).unwrap_or_else(|e| panic!("{e}"));
    paused().block_on(conform(driver, &make, effort))
}

#[test]
fn every_driver_of_the_table_conforms_and_the_page_of_devices_says_so() {
    let drivers = wired();
    let effort = effort(drivers.len() as u64);
    let mut conducts: Vec<Conduct> = drivers.par_iter().map(|driver| tried(driver, effort)).collect();
    let mut all = Counts::default();
    for conduct in &conducts {
        println!("{}:", conduct.driver);
        for finding in &conduct.findings {
            println!("  {:16} {:?}", finding.check.name, finding.verdict);
        }
        all.commands += conduct.noise.commands;
        all.done += conduct.noise.done;
        all.exchanges += conduct.noise.exchanges;
        all.disturbed += conduct.noise.disturbed;
        all.wrong += conduct.noise.wrong;
    }
    println!("under noise, all drivers: {all}");
    let failures: Vec<String> = conducts.iter().flat_map(Conduct::failures).collect();
    assert!(failures.is_empty(), "{} checks failed:\n  {}", failures.len(), failures.join("\n  "));
    conducts.extend(cameras::conducts());
    page::compare(&checks(), &conducts);
}

#[test]
fn a_driver_without_a_twin_is_a_failure() {
    let known = wired()[0];
    let stranger = Driver { name: "zaber-binary", ..*known };
    let error = rig(&stranger, Unit::Ours, Clock::system()).err().expect("nobody has this twin");
    assert!(error.to_string().contains("zaber-binary"), "{error}");
}

#[test]
fn every_driver_meets_every_check_once() {
    let names: std::collections::BTreeSet<&str> = checks().iter().map(|check| check.name).collect();
    assert_eq!(names.len(), checks().len(), "each check has a name of its own");
    let conduct = tried(wired()[0], Effort { commands: 5, exchanges: 0, seed: 2 });
    let met: Vec<&str> = conduct.findings.iter().map(|finding| finding.check.name).collect();
    assert_eq!(met, checks().iter().map(|check| check.name).collect::<Vec<_>>());
}
