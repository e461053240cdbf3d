//! Promise: whatever happens to the bench in the night, each planned exposure is in the morning stored once under its
//! true label or listed as missing with its reason.
//!
//! Nights of more than 1,500 frames with faults drawn from a seed: `GONIOD_NIGHTS` of them (200 when it is not set; `137..138`
//! is one alone), every tenth with faults that last beyond a night's patience, every fourth of the others on a bench with a light monitor, whose
//! lamp has faults too. What a fault ends (a kill, an abort, a failing disk) another process goes on with. The table at the
//! end tells how often every kind of fault really happened.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stderr)]

mod common;
#[path = "common/tiny.rs"]
mod tiny;

use common::text;
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
/// Faults of a night.
const FAULTS: usize = 46;
/// Faults of a night with a light monitor, all of lamp and monitor.
const LIGHT_FAULTS: usize = 30;
/// Every so manieth night is run twice: the same seed gives the same journal.
const TWICE: u64 = 20;
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
    off_response: u64,
    pairs_telling: u64,
    resumed: u64,
    twice: u64,
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
        self.off_response += verdict.off_response.len() as u64;
        self.pairs_telling += verdict.pairs_telling as u64;
        self.alike += verdict.alike as u64;
        self.resumed += u64::from(over.resumed);
        for (kind, n) in &over.fired {
            *self.fired.entry(*kind).or_default() += u64::from(*n);
        }
        self.wrong.extend(over.wrong.iter().map(|what| format!("night {seed}: {what}")));
        let outcome = &over.outcome;
        let ended = format!("{:?} {:?} {:?}", outcome.ending, outcome.message, outcome.summary);
        if !verdict.is_clean() {
            self.wrong.push(format!(
                "night {seed}: {}\n    {ended}\n    {}",
                verdict.lines().join("\n    "),
                told(&over.fired)
            ));
        }
        if !verify(&over.path).unwrap().sound() {
            self.wrong.push(format!("night {seed}: the run directory is damaged"));
        }
        if !outcome.is_safe() {
            self.wrong.push(format!("night {seed}: not safe: {:?}", outcome.safe));
        }
        if !lasting {
            self.transient += 1;
            let whole = outcome.ending == Ending::Completed && verdict.stored == verdict.planned;
            self.unaided += u64::from(whole);
            if !whole {
                eprintln!("night {seed} did not finish: {ended}\n    {}", told(&over.fired));
            }
        }
    }

    fn print(&self) {
        eprintln!("nights {}, frames {}, missing with reason {}", self.nights, self.frames, self.missing);
        eprintln!("lost {}, doubled {}, mislabelled {}", self.lost, self.doubled, self.mislabelled);
        eprintln!("exposures off the response {} of {}", self.off_response, self.pairs_telling);
        eprintln!("black for black {}", self.alike);
        eprintln!("nights whose faults pass: {} of {} finished and whole", self.unaided, self.transient);
        eprintln!("gone on with {} times, nights run twice {}", self.resumed, self.twice);
        eprintln!("faults {}", self.fired.values().sum::<u64>());
        for (kind, n) in &self.fired {
            eprintln!("  {n:6}  {kind}");
        }
    }
}

/// Nights to run: from, to.
fn nights() -> (u64, u64) {
    let asked = std::env::var("GONIOD_NIGHTS").unwrap_or_default();
    let (from, to) = asked.split_once("..").unwrap_or(("0", &asked));
    (from.parse().unwrap_or(0), to.parse().unwrap_or(NIGHTS))
}

/// What happened in a night.
fn told(fired: &BTreeMap<Kind, u32>) -> String {
    fired.iter().map(|(kind, n)| format!("{kind} {n}")).collect::<Vec<_>>().join(", ")
}

/// A bench, and how long its plan takes.
struct House {
    tiny: Tiny,
    span: Duration,
}

// === impl House ===

impl House {
    /// A bench with a full night's plan.
    fn new(tiny: Tiny) -> House {
        let steps = tiny.plan().steps.len();
        assert!(steps >= 1500, "{steps}");
        House::of(tiny)
    }

    fn of(tiny: Tiny) -> House {
        let span = Duration::from_secs_f64(tiny.plan().forecast.total_s());
        House { tiny, span }
    }
}

/// The plain bench, and the one with a light monitor.
struct Houses {
    plain: House,
    light: House,
}

// === impl Houses ===

impl Houses {
    /// Bench and faults of a night; consecutive seeds go round all kinds.
    fn night(&self, seed: u64) -> (&House, Schedule) {
        // The how manieth night of its sort.
        let nth = seed - seed / 10;
        let (house, schedule) = match (seed % 10, nth % 4) {
            (9, _) => (&self.plain, Schedule::of(Mix::Nasty, false, seed / 10, self.plain.span)),
            (_, 1) => (&self.light, Schedule::draw(&light_kinds(), LIGHT_FAULTS, 0.1, nth / 4, self.light.span)),
            _ => (&self.plain, Schedule::draw(&kinds(), FAULTS, 0.1, nth - (nth + 2) / 4, self.plain.span)),
        };
        assert!(schedule.entries.len() >= 15);
        (house, schedule)
    }
}

/// What happens in every night.
fn kinds() -> Vec<Kind> {
    [Kind::transient(), Kind::around()].concat()
}

/// What happens in a night with a light monitor.
fn light_kinds() -> Vec<Kind> {
    Kind::of_the_light()
}

/// Journal, seal and plan of a night.
fn files(over: &Over) -> [Vec<u8>; 3] {
    ["journal.sqlite", "journal.seal", "plan.toml"].map(|name| std::fs::read(over.path.join(name)).unwrap())
}

fn discard(over: &Over) {
    std::fs::remove_dir_all(over.path.parent().unwrap()).unwrap();
}

#[test]
fn nights_with_faults_lose_double_and_mislabel_nothing() {
    let scan = scan_text(48);
    let houses = Houses { plain: House::new(Tiny::new(&scan)), light: House::new(Tiny::with_light(&scan)) };
    let (from, to) = nights();
    let (next, sum) = (AtomicU64::new(from), Mutex::new(Sum::default()));
    std::thread::scope(|scope| {
        for _ in 0..std::thread::available_parallelism().map_or(2, usize::from) {
            scope.spawn(|| {
                loop {
                    let seed = next.fetch_add(1, Ordering::SeqCst);
                    if seed >= to {
                        return;
                    }
                    let (house, schedule) = houses.night(seed);
                    // What lasts may end a night; somebody goes on with it.
                    let lasting = seed % 10 == 9;
                    let over = if lasting {
                        house.tiny.night_until(seed, &schedule, real(), |o| o.ending == Ending::Completed)
                    } else {
                        house.tiny.night(seed, &schedule, real())
                    };
                    sum.lock().unwrap().take(seed, lasting, &over);
                    if seed.is_multiple_of(TWICE) {
                        let first = files(&over);
                        discard(&over);
                        let again = house.tiny.night(seed, &schedule, real());
                        let mut sum = sum.lock().unwrap();
                        sum.twice += 1;
                        if files(&again) != first || again.fired != over.fired {
                            sum.wrong.push(format!("night {seed} went otherwise the second time"));
                        }
                    }
                    discard(&over);
                }
            });
        }
    });
    let sum = sum.into_inner().unwrap();
    sum.print();
    assert!(sum.wrong.is_empty(), "{}", sum.wrong.join("\n"));
    assert_eq!((sum.lost, sum.doubled, sum.mislabelled, sum.off_response), (0, 0, 0, 0));
    assert!(sum.unaided as f64 >= UNAIDED * sum.transient as f64, "{} of {}", sum.unaided, sum.transient);
    // Fewer nights scatter more; a handful has not room for every kind.
    let nights = to - from;
    let share = LEAST * nights / NIGHTS;
    let scatter = if nights < NIGHTS { share.isqrt() } else { 0 };
    let least = (share - scatter).max(u64::from(nights >= 24));
    for kind in [kinds(), light_kinds()].concat() {
        let n = sum.fired.get(&kind).copied().unwrap_or(0);
        assert!(n >= least, "{kind} happened {n} times, at least {least} are wanted");
    }
}

/// What lasts ends a night safely; somebody goes on with it, and nothing is lost. Short nights, so that each kind happens
/// as often as those that pass.
#[test]
fn what_outlasts_the_patience_of_a_night_is_gone_on_with_and_nothing_is_lost() {
    let house = House::of(Tiny::new(&scan_text(1)));
    let lasting = Kind::lasting();
    let (mut fired, mut resumed, mut missing) = (BTreeMap::<Kind, u64>::new(), 0, 0);
    for seed in 0..LEAST * lasting.len() as u64 {
        let kind = lasting[seed as usize % lasting.len()];
        let mut schedule = Schedule::draw(&[kind], 1, 0.0, seed, house.span);
        schedule.entries.extend(Schedule::draw(&kinds(), 2, 0.0, seed, house.span).entries);
        schedule.entries.sort_by_key(|entry| entry.at);
        let over = house.tiny.night_until(seed, &schedule, real(), |outcome| outcome.ending == Ending::Completed);
        let verdict = judge(&over.path).unwrap();
        assert!(verdict.is_clean() && over.wrong.is_empty(), "{kind}: {:?} {:?}", verdict.lines(), over.wrong);
        assert!(verify(&over.path).unwrap().whole() && over.outcome.is_safe(), "{kind}: {:?}", over.outcome);
        (resumed, missing) = (resumed + u64::from(over.resumed), missing + verdict.missing);
        over.fired.iter().for_each(|(kind, n)| *fired.entry(*kind).or_default() += u64::from(*n));
        discard(&over);
    }
    eprintln!("gone on with {resumed} times, missing with reason {missing}: {fired:?}");
    assert!(lasting.iter().all(|kind| fired.get(kind).is_some_and(|n| *n >= LEAST)), "{fired:?}");
}

/// Summer time begins, or ends, in the middle of the night where the bench stands: the same night, byte for byte.
#[test]
fn a_night_in_which_the_clocks_are_changed_is_like_any_other() {
    let lab = Tiny::new(&scan_text(2)).lab;
    for start in ["2026-03-29T00:59:30Z", "2026-10-25T00:59:30Z"] {
        let journal = |zone: &str, runs: &str| {
            let (scan, instrument) = (lab.path("config/scans/night.toml"), lab.instrument());
            let (scan, instrument, folder) = (text(&scan), text(&instrument), text(&lab.path(runs)));
            let args = ["rehearse", &scan, "--instrument", &instrument, "--runs", &folder, "--no-products", "--json"];
            let mut command = lab.command(&args);
            let output = command.args(["--faults", "typical", "--start", start]).env("TZ", zone).output().unwrap();
            assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
            let document: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
            std::fs::read(lab.path(document["run"].as_str().unwrap()).join("journal.sqlite")).unwrap()
        };
        let (here, there) = (journal("Europe/Berlin", "here"), journal("UTC", "there"));
        assert!(here == there, "the night of {start} went otherwise in another time zone");
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
