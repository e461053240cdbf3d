//! Nights with a lamp that the light monitor judges: warming up, going out, struck again.
#![allow(clippy::unwrap_used, clippy::expect_used)]

use super::Job;
use super::fakes::{self, Shared};
use super::interlocks::Reason;
use super::light::LightRules;
use super::state::Ending;
use super::tests::{Night, counts, is_safe, stored_under_true_labels};
use super::trouble_tests::{S, START_US, all_is_stored, disk, trouble, was_suspended_for, watched, when};
use crate::archive::RunDir;
use crate::archive::verify::verify;
use crate::config::night::Interlocks;
use crate::control::events::{Event, EventBus, LampNow};
use crate::control::lamp_hours::LampLog;
use goniod_drivers::clock::{Clock, UtcMicros};
use goniod_drivers::devices::lamp::LampConfig;
use tokio::sync::mpsc;

/// What the light monitor must tell of the lamp, by a warm-up of two minutes.
fn lamp(job: &mut Job<'_>) {
    let lamp = LampConfig { warm_up: 120 * S, slope_over: 120 * S, ..LampConfig::default() };
    job.light = LightRules { lamp: Some(lamp), min_w: Some(1e-4), max_w: Some(1e-2), hours: None };
    job.interlocks = Some(Interlocks { lamp_drift_alarm: None, lamp_drift_warning: None, ..watched() });
}

#[tokio::test(start_paused = true)]
async fn the_first_view_waits_for_a_lamp_that_warms_up() {
    let night = trouble(lamp, disk(), async |_verbs, world: Shared| {
        // Dim and rising at first, then as ever.
        for seconds in 0..30 {
            world.lock().unwrap().power_w = 1e-3 * (0.3 + 0.7 * f64::from(seconds) / 30.0);
            tokio::time::sleep(10 * S).await;
        }
        world.lock().unwrap().power_w = 1e-3;
        std::future::pending().await
    })
    .await;
    assert!(was_suspended_for(&night, Reason::LampWarming));
    all_is_stored(&night);
    let begun_s = when(&night, |e| matches!(e, Event::FrameStored { .. }));
    // The light stands still from 300 s on, and its slope over two minutes is below 0.2 % a minute some time after.
    assert!((400.0..440.0).contains(&begun_s), "{begun_s}");
}

/// Seconds at which these events happened.
fn all_when(night: &Night, wanted: impl Fn(&Event) -> bool) -> Vec<f64> {
    let rows = RunDir::open(&night.path).unwrap().with(|j| j.events()).unwrap();
    let wanted = rows.iter().filter(|row| wanted(&serde_json::from_str(&row.json).unwrap()));
    wanted.map(|row| (row.utc_us - START_US) as f64 / 1e6).collect()
}

fn retaken(night: &Night) -> usize {
    night.events.iter().filter(|e| matches!(e, Event::ViewRetaken { .. })).count()
}

/// Out in the middle of a bracket. Light before the arc can have cooled is no lamp's; then nobody comes for a while, and
/// the lamp that is struck has another level than before.
#[tokio::test(start_paused = true)]
async fn a_lamp_that_goes_out_suspends_until_it_was_struck_again_and_is_steady() {
    let night = trouble(
        |job| {
            lamp(job);
            // Longer than the operator takes, shorter than cooling and warm-up besides.
            let limits = Interlocks { longest_suspension_s: 500.0, lamp_drift_alarm: Some(0.5), ..watched() };
            job.interlocks = Some(limits);
        },
        disk(),
        async |_verbs, world: Shared| {
            for (seconds, power_w) in [(133, 1e-3), (300, 1e-12), (60, 1e-3), (840, 1e-12)] {
                world.lock().unwrap().power_w = power_w;
                tokio::time::sleep(seconds * S).await;
                assert!(power_w < 1e-6 || !world.lock().unwrap().open || seconds == 133, "dark while it is out");
            }
            world.lock().unwrap().power_w = 0.8e-3;
            std::future::pending().await
        },
    )
    .await;
    all_is_stored(&night);
    assert!(was_suspended_for(&night, Reason::LampOut) && was_suspended_for(&night, Reason::LampWarming));
    assert!((1..=2).contains(&retaken(&night)), "{} brackets", retaken(&night));
    let out_s = when(&night, |e| matches!(e, Event::Lamp { lamp: LampNow::Cooling { .. } }));
    assert!((133.0..=143.0).contains(&out_s), "{out_s}");
    let told = night.events.iter().find_map(|e| match e {
        Event::Lamp { lamp: LampNow::Cooling { strike_from, warm_up_s } } => Some((*strike_from, *warm_up_s)),
        _ => None,
    });
    let (strike_from, warm_up_s) = told.unwrap();
    assert!(((strike_from.0 - START_US) as f64 / 1e6 - (out_s + 900.0)).abs() < 11.0, "{strike_from:?} {out_s}");
    assert_eq!(warm_up_s, 120.0);
    let stored = all_when(&night, |e| matches!(e, Event::FrameStored { .. }));
    assert!(stored.iter().all(|s| *s < 145.0 || *s > 133.0 + 1200.0 + 120.0), "{stored:?}");
    assert!(stored.last().is_some_and(|s| *s < 133.0 + 1200.0 + 120.0 + 60.0), "it goes on by itself: {stored:?}");
    let off = all_when(&night, |e| matches!(e, Event::Lamp { lamp: LampNow::Off { .. } }));
    assert_eq!(off.len(), 1, "told once that it may be struck now: {off:?}");
}

/// Found out at the start: nobody knows since when.
#[tokio::test(start_paused = true)]
async fn a_lamp_found_out_is_not_trusted_before_it_can_have_cooled() {
    let night = trouble(lamp, disk(), async |_verbs, world: Shared| {
        world.lock().unwrap().power_w = 0.0;
        tokio::time::sleep(30 * S).await;
        world.lock().unwrap().power_w = 1e-3;
        std::future::pending().await
    })
    .await;
    all_is_stored(&night);
    let begun_s = when(&night, |e| matches!(e, Event::FrameStored { .. }));
    assert!((1020.0..1080.0).contains(&begun_s), "900 s of cooling and 120 s of warm-up: {begun_s}");
    assert_eq!(retaken(&night), 0);
}

#[tokio::test(start_paused = true)]
async fn a_lamp_that_nobody_strikes_ends_the_run_safely_after_the_longest_suspension() {
    let night = trouble(lamp, disk(), async |_verbs, world: Shared| {
        tokio::time::sleep(133 * S).await;
        world.lock().unwrap().power_w = 1e-12;
        std::future::pending().await
    })
    .await;
    assert_eq!(night.outcome.ending, Ending::SuspendedTooLong, "{:?}", night.outcome);
    assert!(night.outcome.message.as_ref().unwrap().contains("lamp-out"), "{:?}", night.outcome.message);
    let ended_s = when(&night, |e| matches!(e, Event::RunEnded { .. }));
    assert!((133.0 + 3600.0 + 1020.0..133.0 + 3600.0 + 1060.0).contains(&ended_s), "{ended_s}");
    is_safe(&night);
}

/// A lamp that goes out in each attempt at a bracket costs that bracket, with the reason, and not the night.
#[tokio::test(start_paused = true)]
async fn a_bracket_in_which_the_lamp_goes_out_again_and_again_is_listed_as_missing() {
    let night = trouble(lamp, disk(), async |_verbs, world: Shared| {
        // Out as soon as exposures are taken, three times.
        for _ in 0..3 {
            while !world.lock().unwrap().open {
                tokio::time::sleep(S / 10).await;
            }
            world.lock().unwrap().power_w = 0.0;
            tokio::time::sleep(1000 * S).await;
            world.lock().unwrap().power_w = 1e-3;
        }
        std::future::pending().await
    })
    .await;
    let (stored, missing, planned) = counts(&night.outcome);
    assert!((12, 3, 0) == (stored, missing, planned), "{:?}", night.outcome);
    let told = |reason: &str| reason == "the lamp went out while the view was taken, 3 times";
    assert!(night.events.iter().any(|e| matches!(e, Event::StepMissing { reason, .. } if told(reason))));
    assert_eq!(stored_under_true_labels(&night.path), stored as usize);
    assert!(verify(&night.path).unwrap().whole());
}

#[tokio::test(start_paused = true)]
async fn a_power_that_cannot_be_the_lamps_own_ends_the_run_safely() {
    let night = trouble(lamp, disk(), async |_verbs, world: Shared| {
        tokio::time::sleep(133 * S).await;
        world.lock().unwrap().power_w = 2e-2;
        std::future::pending().await
    })
    .await;
    assert_eq!(night.outcome.ending, Ending::Alarm, "{:?}", night.outcome);
    assert!(night.outcome.message.as_ref().unwrap().contains("lamp-unsteady"), "{:?}", night.outcome.message);
    is_safe(&night);
}

/// The job with a log of the hours of lamp A-1 in this folder.
fn counted(job: &mut Job<'_>, folder: &std::path::Path) {
    let mut i = crate::config::testing::instrument();
    (i.lamp.serial, i.lamp.hours_at_start) = (Some("A-1".to_owned()), Some(100.0));
    job.light.hours = LampLog::of(&i, folder);
}

/// Hours at the beginning and the end of a run.
fn hours(night: &Night) -> [f64; 2] {
    let told = night.events.iter().filter_map(|e| match e {
        Event::LampHours { age } => age.hours(),
        _ => None,
    });
    told.collect::<Vec<_>>().try_into().expect("told twice")
}

#[tokio::test(start_paused = true)]
async fn the_hours_of_the_lamp_are_counted_while_it_is_seen_burning_and_kept_across_runs() {
    let folder = tempfile::tempdir().unwrap();
    let change = |job: &mut Job<'_>| {
        lamp(job);
        counted(job, folder.path());
    };
    let out_for_half_an_hour = async |_verbs, world: Shared| {
        tokio::time::sleep(133 * S).await;
        world.lock().unwrap().power_w = 0.0;
        tokio::time::sleep(1800 * S).await;
        world.lock().unwrap().power_w = 1e-3;
        std::future::pending().await
    };
    let first = trouble(change, disk(), out_for_half_an_hour).await;
    all_is_stored(&first);
    let ended_s = when(&first, |e| matches!(e, Event::RunEnded { .. }));
    let [begin, end] = hours(&first);
    assert_eq!(begin, 100.0);
    let burnt_s = (end - begin) * 3600.0;
    assert!((ended_s - 1800.0 - 35.0..=ended_s - 1800.0).contains(&burnt_s), "{burnt_s} of {ended_s}");

    let second = trouble(change, disk(), async |_verbs, _world| std::future::pending().await).await;
    let [again, end] = hours(&second);
    assert!((again - begin - burnt_s / 3600.0).abs() < 1e-9 && end > again, "{again} {end}");
}

#[tokio::test(start_paused = true)]
async fn without_a_light_monitor_the_hours_are_those_of_the_runs() {
    let folder = tempfile::tempdir().unwrap();
    let plan = super::tests::plan();
    let (_runs, archive) = super::tests::begun(&plan);
    let clock = Clock::starting_at(UtcMicros(START_US));
    let (mut bench, _world) = fakes::bench(clock);
    bench.devices.light_monitor = None;
    let mut job = super::tests::job(&plan);
    counted(&mut job, folder.path());
    let (_verbs, asked) = mpsc::channel(1);
    super::run(&job, &mut bench, archive, clock, asked, &EventBus::default()).await.unwrap();
    let watched_h = job.light.hours.unwrap().age().unwrap().watched_h.unwrap();
    let ran_s = clock.elapsed().as_secs_f64();
    assert!((ran_s - 1.0..=ran_s).contains(&(watched_h * 3600.0)), "{watched_h} h of {ran_s} s");
}

/// Hours that cannot be read or kept cost no exposure, and nothing is written over them.
#[tokio::test(start_paused = true)]
async fn hours_that_cannot_be_kept_are_told_as_unknown_and_cost_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("lamp-A-1.json");
    std::fs::write(&file, "garbage").unwrap();
    let night = trouble(|job| counted(job, folder.path()), disk(), async |_v, _w| std::future::pending().await).await;
    all_is_stored(&night);
    let told = night.events.iter().filter(|e| matches!(e, Event::ArchiveError { message } if message.contains("A-1")));
    assert_eq!(told.count(), 1, "told once");
    assert!(night.events.iter().any(|e| matches!(e, Event::LampHours { age } if age.hours().is_none())));
    assert_eq!(std::fs::read_to_string(&file).unwrap(), "garbage");
}

#[tokio::test(start_paused = true)]
async fn without_interlocks_nobody_waits_for_the_lamp_and_nothing_is_told_of_it() {
    let unwatched = |job: &mut Job<'_>| {
        lamp(job);
        job.interlocks = None;
    };
    let night = trouble(unwatched, disk(), async |_verbs, _world| std::future::pending().await).await;
    all_is_stored(&night);
    assert!(night.events.iter().any(|e| matches!(e, Event::LightRead { .. })));
    assert!(!night.events.iter().any(|e| matches!(e, Event::Lamp { .. })), "its readings would not count");
}
