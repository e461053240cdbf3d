//! Promise: whatever happens to the bench in the night, each planned exposure is in the morning stored once under its
//! true label or listed as missing with its reason.
//!
//! Nights of more than 1,500 frames with faults drawn from a seed: `GONIOD_NIGHTS` (default below) of them, the last fifth
//! with lasting faults too. The table at the end tells how often every kind of fault really happened.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stderr)]

mod common;
#[path = "common/tiny.rs"]
mod tiny;

use goniod::archive::verify::verify;
use goniod::control::sequencer::state::Ending;
use goniod::front::bench::Schedule;
use goniod::front::oracle::{Verdict, judge};
use goniod_sim::faults::Kind;
use std::collections::BTreeMap;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;
use tiny::{Over, Tiny, quiet, real, scan_text};

#[test]
fn probe() {
    let tiny = Tiny::new(&scan_text(48));
    let plan = tiny.plan();
    eprintln!("steps {} forecast {} s", plan.steps.len(), plan.forecast.total_s());
    let t = std::time::Instant::now();
    let over = tiny.night(1, &quiet(), real());
    eprintln!("{:?} {:?} wall {:?}", over.outcome.ending, over.outcome.summary, t.elapsed());
    let t = std::time::Instant::now();
    let v = judge(&over.path).unwrap();
    eprintln!("{:?} wall {:?}", v.lines(), t.elapsed());
    let span = Duration::from_secs_f64(plan.forecast.total_s());
    for seed in 0..44 {
        let kinds = Kind::transient();
        let schedule = Schedule::draw(&kinds, 20, 0.1, seed, span);
        let t = std::time::Instant::now();
        let over = tiny.night(seed, &schedule, real());
        eprintln!(
            "{:?} {:?} {:?} wall {:?} took {:?}",
            over.outcome.ending,
            over.outcome.message,
            over.outcome.summary,
            t.elapsed(),
            over.took
        );
        eprintln!("  {}", over.counts);
        let v = judge(&over.path).unwrap();
        for l in v.lines().iter().take(9) {
            eprintln!("  {l}");
        }
        if !v.is_clean() {
            for e in goniod::archive::RunDir::open(&over.path).unwrap().with(|j| j.events()).unwrap() {
                if ["device-error", "step-missing", "frame-rejected", "device-opened"].contains(&&*e.kind)
                    && !e.json.contains("lack-unconf")
                    || e.json.contains("\"step\":283")
                {
                    eprintln!("     {} {}", e.utc_us - 1770000000000000, e.json);
                }
            }
        }
        let run = goniod::archive::RunDir::open(&over.path).unwrap();
        for s in run
            .with(|j| j.steps())
            .unwrap()
            .iter()
            .filter(|s| matches!(s.state, goniod::archive::rows::StepState::Missing(_)))
            .take(3)
        {
            eprintln!("   missing {:?}", s.state);
        }
    }
}
