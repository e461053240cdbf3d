//! Brackets of swept integration times with latency, old frames in the queue and faults: no frame under a wrong label.

use crate::bench::{Bench, config, label_is_true, settings};
use crate::shim::twin::{Plan, Stamps};
use goniod_drivers::clock::Clock;
use goniod_drivers::contract::{Camera, Device};
use goniod_drivers::devices::v4l2::V4l2Config;
use std::time::Duration;

/// Ten integration times, a factor 3 apart: 0.1 ms to 1.97 s.
const TIMES: [u64; 10] = [1, 3, 9, 27, 81, 243, 729, 2187, 6561, 19_683];

/// Frames kept at each time.
const FRAMES: usize = 2;

/// What a series of brackets gave.
#[derive(Debug, Default)]
struct Tally {
    kept: u64,
    wrong: u64,
    rejected: u64,
}

fn brackets() -> u64 {
    if std::env::var("GONIOD_FULL").is_ok_and(|v| v == "1") { 1000 } else { 30 }
}

/// Runs brackets, up and down in turn, with the gain changed too.
async fn sweep(bench: &mut Bench, brackets: u64) -> Tally {
    let mut tally = Tally::default();
    for bracket in 0..brackets {
        for step in 0..TIMES.len() {
            let raw = TIMES[if bracket % 2 == 0 { step } else { TIMES.len() - 1 - step }];
            let got = bench.acquire_several(settings(raw, (bracket % 5) as f64), FRAMES).await;
            tally.kept += got.frames.len() as u64;
            tally.wrong += got.frames.iter().filter(|f| !label_is_true(f)).count() as u64;
            tally.rejected += got.rejected;
        }
    }
    tally
}

fn rough(seed: u64, stamps: Stamps) -> Plan {
    Plan {
        latency: (0, 5),
        fault_every: 8,
        // Writing a control takes three frame intervals: old frames pile up in the queue meanwhile.
        ioctl_ns: (50_000, 120_000_000),
        stamps,
        seed,
        ..Plan::default()
    }
}

async fn no_label_is_wrong(name: &str, plan: Plan, config: V4l2Config, brackets: u64) {
    let mut bench = Bench::open(plan, config).await;
    let tally = sweep(&mut bench, brackets).await;
    bench.camera.stop().await.unwrap();
    let counted = bench.camera.counters().await.unwrap();
    let made = bench.twin().made;
    eprintln!("{name}: {brackets} brackets, {tally:?}\n  driver {counted:?}\n  twin {made:?}");
    assert_eq!((tally.kept, tally.wrong), (brackets * 20, 0), "frames under a wrong label");
    assert_eq!(counted.dequeued, made.dequeued);
    assert_eq!(
        (counted.lost, counted.damaged, counted.short, counted.repeated, counted.stale),
        (made.lost, made.error, made.short, made.repeated, made.stale),
        "rejected = faults made: lost, damaged, short, repeated, stale"
    );
    assert!(tally.rejected > 0, "some faults met the acquire loop, not only the settling frames");
    for kind in [made.lost, made.error, made.short, made.repeated, made.stale] {
        assert!(kind > 0, "each kind of fault was made: {made:?}");
    }
}

#[tokio::test]
async fn swept_brackets_never_carry_a_wrong_label() {
    no_label_is_wrong("end-of-frame stamps", rough(1, Stamps::End), config("labels-end"), brackets()).await;
}

#[tokio::test]
async fn swept_brackets_with_start_of_exposure_stamps_never_carry_a_wrong_label() {
    no_label_is_wrong("start stamps", rough(2, Stamps::Start), config("labels-start"), brackets() / 3).await;
}

/// The same bench with each fixed latency, so that no one of them hides among the others.
#[tokio::test]
async fn every_latency_from_0_to_5_is_outwaited() {
    for latency in 0..=5 {
        let name = format!("labels-latency-{latency}");
        let plan = Plan { latency: (latency, latency), fault_every: 0, ..rough(3 + latency, Stamps::End) };
        let mut bench = Bench::open(plan, config(&name)).await;
        let tally = sweep(&mut bench, 3).await;
        assert_eq!((tally.kept, tally.wrong), (60, 0), "latency {latency}");
    }
}

/// The proof that these tests can fail: a driver told too small an N keeps frames of old settings.
#[tokio::test]
async fn too_small_an_n_shows_as_wrong_labels() {
    let plan = Plan { latency: (3, 3), fault_every: 0, ..rough(9, Stamps::End) };
    let mut bench = Bench::open(plan, V4l2Config { settle_frames: 1, ..config("labels-small-n") }).await;
    let tally = sweep(&mut bench, 2).await;
    assert!(tally.wrong > 0, "{tally:?}");
}

/// Without stamps nothing tells a queued frame from a fresh one: as many as the queue holds are counted out.
#[tokio::test]
async fn without_stamps_frames_are_counted_out() {
    let plan = Plan { fault_every: 0, ..rough(10, Stamps::Unknown) };
    let mut bench = Bench::open(plan, config("labels-unstamped")).await;
    let tally = sweep(&mut bench, 3).await;
    assert_eq!((tally.kept, tally.wrong), (60, 0));
    let health = bench.camera.health().await.unwrap();
    assert!(health.warnings.iter().any(|w| w.contains("no usable time stamps")), "{health:?}");
}

/// A bench that moved (same settings): the frame under way at the arming is not handed out.
#[tokio::test]
async fn an_arming_without_new_settings_waits_for_a_frame_that_starts_later() {
    let mut bench = Bench::open(Plan::default(), config("labels-arm")).await;
    bench.acquire(settings(5000, 1.0)).await;
    for _ in 0..20 {
        let armed = bench.camera.arm().await.unwrap();
        let frame = bench.camera.next_frame().await.unwrap();
        assert!(frame.info.exposure_start >= armed.not_before);
        assert!(frame.info.received >= frame.info.exposure_start + frame.info.settings.exposure.duration());
    }
}

/// Instants of frames are those of the daemon's clock: what a guard compares with its own `now` must fit, however long
/// the opening took.
#[tokio::test]
async fn the_cameras_instants_are_the_daemons() {
    let slow = Duration::from_millis(300);
    let before = Clock::system().now();
    // As much real time for each wait as the twin's clock runs in it.
    let plan = Plan { pace_us: 40_000, ..Plan::default() };
    let mut bench = Bench::closed(plan, config("labels-instants"));
    bench.twin().hang_us = slow.as_micros() as u32;
    bench.camera.open().await.unwrap();
    bench.camera.apply(settings(1, 1.0)).await.unwrap();
    let armed = bench.camera.arm().await.unwrap();
    let after = Clock::system().now();
    assert!(armed.not_before >= before + slow, "{:?} after the beginning", armed.not_before - before);
    assert!(armed.not_before <= after + Duration::from_millis(100));
    let frame = bench.camera.next_frame().await.unwrap();
    assert!(frame.info.exposure_start >= armed.not_before && frame.info.exposure_start < frame.info.received);
}
