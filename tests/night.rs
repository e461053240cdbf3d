//! Promise: whatever happens to the bench in the night, each planned exposure is in the morning stored once under its
//! true label or listed as missing with its reason.
//!
//! Nights of more than 1,500 frames with faults drawn from a seed: `GONIOD_NIGHTS` of them (200 when it is not set), every
//! tenth with faults that last beyond a night's patience. The table at the end tells how often every kind of fault really
//! happened.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stderr)]

mod common;
#[path = "common/tiny.rs"]
mod tiny;

use goniod::archive::verify::verify;
use goniod::control::sequencer::state::Ending;
use goniod::front::bench::Schedule;
use goniod::front::oracle::judge;
use goniod_sim::faults::{Kind, Mix};
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;
use tiny::{Over, SlowDisk, Tiny, quiet, real, scan_text};

/// Nights without the variable.
const NIGHTS: u64 = 200;
/// Faults of a night with transient faults.
const FAULTS: usize = 24;
/// Least times that a kind must have happened, for 200 nights.
const LEAST: u64 = 50;
/// Least share of the nights with transient faults only that finish unaided with everything stored.
const UNAIDED: f64 = 0.995;

/// What all nights gave together.
#[derive(Default)]
struct Sum {
    nights: u64,
    frames: u64,
    missing: u64,
    lost: u64,
    doubled: u64,
    mislabelled: u64,
    falling: u64,
    alike: u64,
    transient: u64,
    unaided: u64,
    fired: BTreeMap<Kind, u64>,
    /// What must not be, night by night.
    wrong: Vec<String>,
}

// === impl Sum ===

impl Sum {
    fn take(&mut self, seed: u64, lasting: bool, over: &Over) {
        let verdict = judge(&over.path).unwrap();
        self.nights += 1;
        self.frames += verdict.stored as u64;
        self.missing += verdict.missing as u64;
        self.lost += verdict.lost.len() as u64;
        self.doubled += verdict.doubled.len() as u64;
        self.mislabelled += verdict.mislabelled.len() as u64;
        self.falling += verdict.falling.len() as u64;
        self.alike += verdict.alike as u64;
        for (kind, n) in over.counts.fired() {
            *self.fired.entry(kind).or_default() += u64::from(n);
        }
        let outcome = &over.outcome;
        let ended = format!("{:?} {:?} {:?}", outcome.ending, outcome.message, outcome.summary);
        if !verdict.is_clean() {
            self.wrong.push(format!(
                "night {seed}: {}\n    {ended}\n    {}",
                verdict.lines().join("\n    "),
                over.counts
            ));
        }
        if !verify(&over.path).unwrap().sound() {
            self.wrong.push(format!("night {seed}: the run directory is damaged"));
        }
        if !outcome.is_safe() && !lasting {
            self.wrong.push(format!("night {seed}: not safe: {:?}", outcome.safe));
        }
        if !lasting {
            self.transient += 1;
            let whole = outcome.ending == Ending::Completed && verdict.stored == verdict.planned;
            self.unaided += u64::from(whole);
            if !whole {
                eprintln!("night {seed} did not finish unaided: {ended}\n    {}", over.counts);
            }
        }
    }

    fn print(&self) {
        eprintln!("nights {}, frames {}, missing with reason {}", self.nights, self.frames, self.missing);
        eprintln!("lost {}, doubled {}, mislabelled {}", self.lost, self.doubled, self.mislabelled);
        eprintln!("brackets that fall {}, black for black {}", self.falling, self.alike);
        eprintln!("with transient faults only: {} of {} finished unaided and whole", self.unaided, self.transient);
        eprintln!("faults {}", self.fired.values().sum::<u64>());
        for (kind, n) in &self.fired {
            eprintln!("  {n:6}  {kind}");
        }
    }
}

/// Nights to run.
fn nights() -> u64 {
    std::env::var("GONIOD_NIGHTS").ok().and_then(|n| n.parse().ok()).unwrap_or(NIGHTS)
}

#[test]
fn nights_with_faults_lose_double_and_mislabel_nothing() {
    let tiny = Tiny::new(&scan_text(48));
    let plan = tiny.plan();
    assert!(plan.steps.len() >= 1500, "{}", plan.steps.len());
    let span = Duration::from_secs_f64(plan.forecast.total_s());
    let (nights, next, sum) = (nights(), AtomicU64::new(0), Mutex::new(Sum::default()));
    std::thread::scope(|scope| {
        for _ in 0..std::thread::available_parallelism().map_or(2, usize::from) {
            scope.spawn(|| {
                loop {
                    let seed = next.fetch_add(1, Ordering::SeqCst);
                    if seed >= nights {
                        return;
                    }
                    let lasting = seed % 10 == 9;
                    let schedule = if lasting {
                        Schedule::of(Mix::Nasty, seed / 10, span)
                    } else {
                        Schedule::draw(&Kind::transient(), FAULTS, 0.1, seed - seed / 10, span)
                    };
                    assert!(schedule.entries.len() >= 15);
                    let over = tiny.night(seed, &schedule, real());
                    sum.lock().unwrap().take(seed, lasting, &over);
                    std::fs::remove_dir_all(over.path.parent().unwrap()).unwrap();
                }
            });
        }
    });
    let sum = sum.into_inner().unwrap();
    sum.print();
    assert!(sum.wrong.is_empty(), "{}", sum.wrong.join("\n"));
    assert_eq!((sum.lost, sum.doubled, sum.mislabelled, sum.falling), (0, 0, 0, 0));
    assert!(sum.unaided as f64 >= UNAIDED * sum.transient as f64, "{} of {}", sum.unaided, sum.transient);
    let least = LEAST * nights / NIGHTS;
    for kind in Kind::transient() {
        let n = sum.fired.get(&kind).copied().unwrap_or(0);
        assert!(n >= least, "{kind} happened {n} times, at least {least} are wanted");
    }
}

/// The same seed gives the same night, event for event: times, retries, frames.
#[test]
fn the_same_seed_gives_the_same_journal() {
    let tiny = Tiny::new(&scan_text(6));
    let span = Duration::from_secs_f64(tiny.plan().forecast.total_s());
    for seed in [3, 4] {
        let schedule = Schedule::draw(&Kind::transient(), 12, 0.2, seed, span);
        let files = |over: &Over| {
            let read = |name: &str| std::fs::read(over.path.join(name)).unwrap();
            let files = (read("journal.sqlite"), read("journal.seal"), read("plan.toml"));
            std::fs::remove_dir_all(over.path.parent().unwrap()).unwrap();
            files
        };
        let one = tiny.night(seed, &schedule, real());
        let (fired, first) = (one.counts.fired(), files(&one));
        let two = tiny.night(seed, &schedule, real());
        assert!(one.counts.total() > 0 && fired == two.counts.fired());
        assert!(first == files(&two), "night {seed} went otherwise the second time");
    }
}

/// A slow disk makes the scan wait; nothing is dropped, nothing is different.
#[test]
fn a_slow_disk_makes_the_scan_wait_and_drops_nothing() {
    let tiny = Tiny::new(&scan_text(2));
    let slow = Arc::new(SlowDisk::new(Duration::from_millis(2)));
    let over = tiny.night(5, &quiet(), slow.clone());
    let verdict = judge(&over.path).unwrap();
    assert_eq!((verdict.stored, verdict.faults()), (verdict.planned, 0));
    assert!(slow.writes() >= verdict.planned as u64, "every frame went through the slow disk");
}
