//! Promise: a lamp that changes is told by the light monitor and costs no truth. A bracket during which it changed is taken
//! again, everything is scaled to its first level, exposures wait while it is out, a monitor that is silent ends the run.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stderr)]

mod common;

use common::{Lab, text};
use goniod::archive::RunDir;
use goniod::archive::verify::verify;
use goniod::config::check::{Options, check};
use goniod::control::events::{Event, EventBus, LampNow};
use goniod::control::sequencer::interlocks::Reason;
use goniod::control::sequencer::run::Outcome;
use goniod::control::sequencer::state::{Ending, State};
use goniod::engine::bsdf::set::Column;
use goniod::front::bench::{Rehearsal, open_simulated};
use goniod::front::night;
use goniod::front::oracle::judge;
use goniod::products::reduce::{Run, reduce};
use goniod_drivers::clock::{Clock, UtcMicros};
use goniod_sim::truth::lamp::LampFault;
use goniod_sim::twins::{Fault, Twins};
use std::path::PathBuf;
use std::time::Duration;
use tokio::sync::mpsc;

/// Between the references at both ends of the night stand the views of which the middle one has least light.
const SCAN: &str = r#"
name = "drift"
[sample]
thickness_mm = 4.0
simulated = "../sim/samples/lambertian_t20.toml"
[incidence]
directions = [[0, 180], [20, 180], [40, 180], [50, 180], [60, 180]]
sides = ["transmission-front"]
[bands]
use = ["f4", "f5"]
[exposure]
policy = "ladder"
ratio = 8.0
shortest_s = 0.03
longest_s = 15.36
[dark]
frames = 1
"#;

/// Interlocks of the instrument with a light monitor.
const INTERLOCKS: &str = "period_s = 10.0\nlamp_drift_warning = 0.08\ndrift_per_view = 0.01";

/// By how much the lamp drifts, and back, in the night.
const DRIFT: f64 = 0.03;

/// A night that is over.
struct Over {
    /// The folder of the run lives as long as this.
    _lab: Lab,
    path: PathBuf,
    outcome: Outcome,
    events: Vec<Event>,
}

/// A small lab, with or without light monitor.
fn lab(light: bool) -> Lab {
    let lab = Lab::small();
    if light {
        lab.add_light(INTERLOCKS);
    }
    lab
}

/// Measures the scan while `act` does to the lamp what it likes; it is told the night's forecast.
fn night(lab: Lab, act: impl AsyncFnOnce(Twins, Duration)) -> Over {
    let scan = lab.scan("drift.toml", SCAN);
    let options = Options { drivers: Vec::new(), today: jiff::civil::date(2026, 3, 4) };
    let checked = check(&scan, &lab.instrument(), &options).unwrap_or_else(|e| panic!("{e}"));
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().start_paused(true).build().unwrap();
    let (path, outcome) = runtime.block_on(async {
        let clock = Clock::starting_at(UtcMicros(1_770_000_000_000_000));
        let plan = night::plan(&checked).unwrap_or_else(|e| panic!("{:?}", e.messages));
        let span = Duration::from_secs_f64(plan.forecast.total_s());
        let mut opened = open_simulated(&checked, &Rehearsal::default(), clock).unwrap();
        let twins = opened.faults.as_ref().unwrap().twins.clone();
        let night = night::prepare(&checked, plan, &lab.path("runs"), clock, opened.seed);
        let night = night.unwrap_or_else(|e| panic!("{:?}", e.messages));
        let (_verbs, asked) = mpsc::channel(1);
        let bus = EventBus::default();
        let measured = night::measure(&checked, &night, &mut opened, clock, asked, &bus);
        let (outcome, ()) = tokio::join!(measured, act(twins, span));
        (night.path, outcome.unwrap_or_else(|e| panic!("{:?}", e.messages)))
    });
    let rows = RunDir::open(&path).unwrap().with(|j| j.events()).unwrap();
    let events = rows.iter().map(|row| serde_json::from_str(&row.json).unwrap()).collect();
    Over { _lab: lab, path, outcome, events }
}

fn is_whole(over: &Over) {
    assert_eq!(over.outcome.ending, Ending::Completed, "{:?}", over.outcome);
    assert_eq!((over.outcome.summary.missing, over.outcome.summary.planned), (0, 0));
    assert!(verify(&over.path).unwrap().whole());
    let verdict = judge(&over.path).unwrap();
    assert!(verdict.is_clean() && verdict.pairs_telling > 0, "{:?}", verdict.lines());
}

fn retaken(over: &Over) -> usize {
    over.events.iter().filter(|e| matches!(e, Event::ViewRetaken { .. })).count()
}

fn was_suspended_for(over: &Over, reason: Reason) -> bool {
    let into = |e: &Event| matches!(e, Event::StateChanged { to: State::Suspended(why), .. } if why.contains(&reason));
    over.events.iter().any(into)
}

/// Down by [`DRIFT`] until the middle of the night, and up again: the references at both ends see nothing of it.
async fn down_and_up(twins: Twins, span: Duration) {
    let hours = span.as_secs_f64() / 2.0 / 3600.0;
    for rate in [-DRIFT / hours, DRIFT / hours, 0.0] {
        twins.inject(Fault::Lamp(LampFault::Drift(rate)));
        tokio::time::sleep(span / 2).await;
    }
}

/// The total is the steady lamp's within twice its standard uncertainty.
fn is_the_same(found: &Column, steady: &Column) {
    let Column { hemispherical: value, hemispherical_u: u, .. } = found;
    let far = (value - steady.hemispherical).abs();
    assert!(far <= 2.0 * u, "{value} +- {u} instead of {}", steady.hemispherical);
}

fn columns(over: &Over) -> Vec<Column> {
    is_whole(over);
    reduce(&Run::open(&over.path).unwrap()).unwrap().set.columns
}

#[test]
fn a_lamp_that_drifts_gives_the_same_bsdf_and_without_the_monitor_would_not() {
    let steady = columns(&night(lab(true), async |_, _| ()));
    let corrected = columns(&night(lab(true), down_and_up));
    let uncorrected = columns(&night(lab(false), down_and_up));
    let (mut worst, mut worst_without) = (0.0_f64, 0.0_f64);
    let (mut patches, mut within, mut within_without) = (0, 0, 0);
    for ((a, b), c) in steady.iter().zip(&corrected).zip(&uncorrected) {
        assert_eq!((a.side, a.incident, a.quantity), (b.side, b.incident, b.quantity));
        worst = worst.max((b.hemispherical / a.hemispherical - 1.0).abs());
        worst_without = worst_without.max((c.hemispherical / a.hemispherical - 1.0).abs());
        is_the_same(b, a);
        for ((a, b), c) in a.patches.iter().zip(&b.patches).zip(&c.patches).filter(|((a, _), _)| a.bsdf.is_finite()) {
            patches += 1;
            within += usize::from((b.bsdf - a.bsdf).abs() <= 2.0 * b.u);
            within_without += usize::from((c.bsdf - a.bsdf).abs() <= 2.0 * c.u);
        }
    }
    eprintln!("largest change with monitor {worst:.4}, without {worst_without:.4}");
    eprintln!("{within} of {patches} patches within 2 u with monitor, {within_without} without");
    assert!(patches > 100 && within as f64 >= 0.99 * patches as f64, "{within} of {patches}");
    assert!(worst < 0.004, "{worst}");
    let missed = steady
        .iter()
        .zip(&uncorrected)
        .any(|(a, c)| (c.hemispherical - a.hemispherical).abs() > 2.0 * c.hemispherical_u);
    assert!(missed && worst_without > 0.6 * DRIFT, "{worst_without}: the drift was there");
}

/// Where nothing watches the lamp the exposures of a bracket still tell that it changed between them.
#[test]
fn a_lamp_that_jumps_in_mid_bracket_shows_in_the_exposures_and_widens_the_uncertainty() {
    let reduced = |over: &Over| {
        is_whole(over);
        reduce(&Run::open(&over.path).unwrap()).unwrap()
    };
    let told = |notes: &[String]| notes.iter().filter(|n| n.contains("the light changed meanwhile")).count();
    let steady = reduced(&night(lab(false), async |_, _| ()));
    assert_eq!(told(&steady.facts.notes), 0, "{:?}", steady.facts.notes);
    let jumped = reduced(&night(lab(false), async |twins, span| {
        tokio::time::sleep(span.mul_f64(0.44)).await;
        twins.inject(Fault::Lamp(LampFault::Jump(-0.18)));
    }));
    assert_eq!(told(&jumped.facts.notes), 1, "{:?}", jumped.facts.notes);
    let wider =
        |(a, b): (&Column, &Column)| b.hemispherical_u / b.hemispherical > 1.5 * a.hemispherical_u / a.hemispherical;
    let columns = steady.set.columns.iter().zip(&jumped.set.columns);
    let (n, all) = (columns.clone().filter(|pair| wider(*pair)).count(), columns.count());
    assert!(n > 0 && n < all, "{n} of {all} columns are less certain");
}

#[test]
fn a_bracket_during_which_the_lamp_jumped_is_taken_again() {
    let over = night(lab(true), async |twins, span| {
        for by in [-0.04, 0.04] {
            tokio::time::sleep(span.mul_f64(0.31)).await;
            twins.inject(Fault::Lamp(LampFault::Jump(by)));
        }
    });
    is_whole(&over);
    let n = retaken(&over);
    assert!((1..=2).contains(&n), "{n} brackets were taken again");
    let quiet = night(lab(true), async |_, _| ());
    assert_eq!(retaken(&quiet), 0, "a lamp that only flickers costs no bracket");
}

/// Out in the middle of a bracket, struck again when the arc is cold: exposures wait, the bracket is taken again.
#[test]
fn exposures_wait_while_the_lamp_is_out() {
    let over = night(lab(true), async |twins, span| {
        tokio::time::sleep(span.mul_f64(0.5)).await;
        twins.inject(Fault::Lamp(LampFault::Off));
        tokio::time::sleep(Duration::from_secs(900)).await;
        twins.inject(Fault::Lamp(LampFault::Strike));
    });
    is_whole(&over);
    assert!(retaken(&over) >= 1 && was_suspended_for(&over, Reason::LampUnsteady));
}

/// The lamp's warm-up is known: it is told when it may be struck, light before then is not trusted, and what was taken
/// before and after it is one measurement.
#[test]
fn a_lamp_that_was_struck_again_is_waited_for_and_costs_no_truth() {
    let steady = columns(&night(lab(true), async |_, _| ()));
    let warming = lab(true);
    let lamp = ("\n[holder]\n", "warm_up_s = 300.0\nrestrike_s = 700.0\n\n[holder]\n");
    warming.edit("instrument.sim.toml", &[lamp], true);
    let over = night(warming, async |twins, span| {
        tokio::time::sleep(Duration::from_secs(300) + span.mul_f64(0.5)).await;
        twins.inject(Fault::Lamp(LampFault::Off));
        tokio::time::sleep(Duration::from_secs(1500)).await;
        twins.inject(Fault::Lamp(LampFault::Strike));
    });
    is_whole(&over);
    assert!(was_suspended_for(&over, Reason::LampOut) && was_suspended_for(&over, Reason::LampWarming));
    let told = |wanted: fn(&LampNow) -> bool| {
        over.events.iter().filter(|e| matches!(e, Event::Lamp { lamp } if wanted(lamp))).count()
    };
    assert_eq!(told(|lamp| matches!(lamp, LampNow::Cooling { .. })), 1);
    assert_eq!((told(|lamp| *lamp == LampNow::Steady), told(|l| matches!(l, LampNow::Off { .. }))), (2, 1));
    for (a, b) in steady.iter().zip(&columns(&over)) {
        is_the_same(b, a);
    }
}

#[test]
fn a_lamp_beyond_its_alarm_and_a_silent_monitor_end_the_run_safely() {
    let alarmed = lab(true);
    alarmed.edit("instrument.sim.toml", &[("lamp_drift_warning = 0.08", "lamp_drift_alarm = 0.5")], true);
    let out = night(alarmed, async |twins, span| {
        tokio::time::sleep(span.mul_f64(0.5)).await;
        twins.inject(Fault::Lamp(LampFault::Off));
    });
    let silent = night(lab(true), async |twins, span| {
        tokio::time::sleep(span.mul_f64(0.5)).await;
        twins.inject(Fault::Unplugged("sim:light-monitor".to_owned(), Duration::from_secs(3600)));
    });
    for (over, word) in [(out, "lamp-unsteady"), (silent, "silent")] {
        assert_eq!(over.outcome.ending, Ending::Alarm, "{:?}", over.outcome);
        assert!(over.outcome.is_safe() && over.outcome.summary.planned > 0);
        let message = over.outcome.message.unwrap();
        assert!(message.contains(word), "{message}");
    }
}

/// One short night in real time: a rehearsal burns no lamp.
#[test]
fn the_hours_of_the_lamp_are_warned_of_counted_and_shown() {
    let lab = Lab::small();
    let lamp = "serial = \"HMI-0042\"\nhours_at_start = 749.999\nrated_hours = 750.0\n\n[holder]\n";
    lab.edit("instrument.sim.toml", &[("\n[holder]\n", lamp)], true);
    let short = SCAN.replace("[0, 180], [20, 180], [40, 180], [50, 180], [60, 180]", "[0, 180]");
    let short = short.replace("\"f4\", ", "").replace("15.36", "0.24") + "[reference]\nmode = \"irradiance\"\n";
    let (scan, instrument) = (text(&lab.scan("short.toml", &short)), text(&lab.instrument()));
    let warned = "will exceed its rated 750 h during this run";
    let checked = lab.goniod(&["check", &scan, "--instrument", &instrument, "--json"]);
    assert!(checked.err.contains(warned) && checked.out.contains(warned), "{}", checked.err);
    let ran = lab.goniod(&["run", &scan, "--instrument", &instrument, "--json"]);
    assert!(ran.code == 0 && ran.err.contains(warned), "{}\n{}", ran.out, ran.err);
    let ran: serde_json::Value = serde_json::from_str(&ran.out).unwrap();
    let kept = std::fs::read_to_string(lab.path("runs/lamp-HMI-0042.json")).unwrap();
    let kept: serde_json::Value = serde_json::from_str(&kept).unwrap();
    let (watched_s, took_s) = (kept["watched_s"].as_f64().unwrap(), ran["took_s"].as_f64().unwrap());
    assert!(watched_s > 3.6 && watched_s <= took_s, "{watched_s} s of {took_s} s");
    let said = lab.goniod(&["status", "--instrument", &instrument]);
    assert!(said.out.contains("lamp HMI-0042: 750.0 h of 750 h rated"), "{}", said.out);
    let report = std::fs::read_to_string(lab.path(ran["run"].as_str().unwrap()).join("products/report.html")).unwrap();
    assert!(report.contains("lamp HMI-0042: 750.0 h at the beginning, 750.0 h at the end; rated 750 h"));
    let over = lab.goniod(&["check", &scan, "--instrument", &instrument]);
    assert!(over.err.contains("longer than its rated 750 h: replace it"), "{}", over.err);
}
