//! Brackets of swept integration times with every kind of lying frame among them: no label may be wrong.

use crate::bench::{Guard, alone, full, open, options, read, settings, twin};
use goniod_drivers::contract::{Armed, Camera};
use goniod_drivers::devices::aravis::{AravisCamera, Trigger, WireFormat};
use goniod_drivers::error::Result;
use goniod_drivers::frame::Frame;
use goniod_sim::gige::{FrameFault, GigeTwin, Reading, Truth};
use std::collections::HashMap;
use std::time::Duration;

/// What became of the frames of many brackets.
#[derive(Debug, Default)]
struct Tally {
    accepted: u64,
    wrong_labels: u64,
    rejected: u64,
    rejected_without_fault: u64,
    discarded: u64,
    faults_judged: u64,
    faults: HashMap<FrameFault, u64>,
    old_exposures: u64,
}

/// Frames cut short on purpose hold up those behind them this long.
const RETENTION: Duration = Duration::from_millis(150);
/// Frames that may be refused in a row before the test gives up.
const PATIENCE: u32 = 60;

async fn expose(
    camera: &mut AravisCamera,
    guard: &mut Guard,
    exposure_us: u64,
    judged: &mut Vec<(u64, bool)>,
) -> Result<Frame> {
    let applied = camera.apply(settings(exposure_us)).await?;
    assert_eq!(applied, settings(exposure_us));
    let mut armed: Armed = camera.arm().await?;
    guard.armed();
    let mut thrown = 0;
    for _ in 0..PATIENCE {
        let frame = camera.next_frame().await?;
        let id = frame.info.device_frame_id;
        if thrown < armed.discard {
            // Only a frame that is sound by itself counts as one that went through the sensor.
            if guard.judge(&frame, &armed, None).is_ok() {
                thrown += 1;
            }
            continue;
        }
        match guard.judge(&frame, &armed, Some(applied)) {
            Ok(()) => {
                judged.push((id, true));
                return Ok(frame);
            }
            Err(_) => {
                judged.push((id, false));
                armed = camera.arm().await?;
                guard.armed();
                thrown = 0;
            }
        }
    }
    panic!("no good frame of {exposure_us} µs in {PATIENCE} tries");
}

async fn brackets(camera: &mut AravisCamera, twin: &GigeTwin, format: WireFormat, count: u32) -> Tally {
    let mut tally = Tally::default();
    let mut guard = Guard::default();
    let mut judged: Vec<(u64, bool)> = Vec::new();
    for bracket in 0..count {
        twin.faults(|f| f.latency_frames = bracket % 6);
        for step in 0..10 {
            let exposure_us = 500 << ((step + bracket) % 10);
            let frame = expose(camera, &mut guard, exposure_us, &mut judged).await.unwrap_or_else(|error| {
                panic!("bracket {bracket}, {exposure_us} µs: {error}; {:?}; twin {:?}", camera.counts(), twin.traffic())
            });
            tally.accepted += 1;
            let right = matches!(read(&frame, format), Reading::Whole(tag) if tag.exposure_us == exposure_us)
                && frame.info.settings == settings(exposure_us);
            tally.wrong_labels += u64::from(!right);
        }
    }
    settle(&mut tally, &twin.truth(), &judged);
    tally
}

/// Holds what was judged against what the twin really did.
fn settle(tally: &mut Tally, truth: &[Truth], judged: &[(u64, bool)]) {
    let verdicts: HashMap<u64, bool> = judged.iter().copied().collect();
    for t in truth {
        if let Some(fault) = t.fault {
            *tally.faults.entry(fault).or_default() += 1;
        }
        tally.old_exposures += u64::from(t.exposure_us != t.commanded_us);
        let verdict = verdicts.get(&t.sequence);
        tally.faults_judged += u64::from(verdict.is_some() && t.fault.is_some());
        match verdict {
            None => tally.discarded += 1,
            Some(true) if t.fault.is_some() || t.exposure_us != t.commanded_us => {
                println!("wrong: {t:?}");
                tally.wrong_labels += 1;
            }
            Some(true) => {}
            Some(false) => {
                tally.rejected += 1;
                tally.rejected_without_fault += u64::from(t.fault.is_none());
            }
        }
    }
}

fn lies(twin: &GigeTwin) {
    twin.faults(|f| {
        (f.stale_per_1000, f.repeated_per_1000, f.short_per_1000) = (15, 15, 5);
        f.half_changed = true;
    });
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn no_label_is_wrong_with_a_software_trigger() {
    let _alone = alone().await;
    let twin = twin(|_| {});
    let format = WireFormat::Mono12p;
    let mut camera = open(options(&twin, |o| {
        (o.discard_frames, o.format) = (6, format);
        o.frame_retention = RETENTION;
    }))
    .await;
    lies(&twin);
    let count = if full() { 500 } else { 12 };
    let tally = brackets(&mut camera, &twin, format, count).await;
    println!("software trigger, {count} brackets of ten: {tally:?}; {:?}", camera.counts());
    assert_eq!((tally.accepted, tally.wrong_labels), (u64::from(count) * 10, 0));
    assert_eq!(tally.rejected, tally.faults_judged, "with a trigger the frames refused are the faults made, no more");
    assert!(tally.rejected > 0 && tally.faults.len() == 4, "the faults did happen");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn no_label_is_wrong_in_free_run_without_chunks() {
    let _alone = alone().await;
    let twin = twin(|c| c.seed = 2);
    let format = WireFormat::Mono12;
    let mut camera = open(options(&twin, |o| {
        o.trigger = Trigger::FreeRun { frame_rate_hz: 200.0 };
        (o.discard_frames, o.format, o.chunks) = (6, format, false);
        o.frame_retention = RETENTION;
    }))
    .await;
    lies(&twin);
    let count = if full() { 500 } else { 12 };
    let tally = brackets(&mut camera, &twin, format, count).await;
    println!("free run, {count} brackets of ten: {tally:?}; {:?}", camera.counts());
    assert_eq!((tally.accepted, tally.wrong_labels), (u64::from(count) * 10, 0));
    // A host that falls behind loses frames of a free run: those gaps are refused as well.
    assert_eq!(tally.rejected - tally.rejected_without_fault, tally.faults_judged);
    assert!(tally.rejected > 0 && tally.old_exposures > 0, "the faults did happen");
}
