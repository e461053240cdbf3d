//! Promise: every label is true. The simulated cameras paint what they really saw into spare rows of each frame; an
//! oracle reads stored files only and compares the painting with the plan. Zero wrong labels, also when the cameras
//! cannot restart their streams and when they lie, lose frames or repeat them.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stderr)]

mod common;
#[cfg(feature = "aravis")]
#[path = "labels/gige.rs"]
mod gige;

use common::Lab;
use goniod::archive::verify::verify;
use goniod::config::check::{Options, check};
use goniod::control::events::{Event, EventBus};
use goniod::control::plan::{Step, Subject, View};
use goniod::front::bench::{Faults, Rehearsal, open_simulated};
use goniod::front::night;
use goniod::front::oracle::brackets::{BracketFrame, Sensor, Told};
use goniod::front::oracle::{Files, Verdict, differences, judge};
use goniod_drivers::clock::{Clock, UtcMicros};
use goniod_drivers::units::ExposureTime;
use goniod_sim::camera::CameraFault;
use goniod_sim::firmware::fw212c::WheelFault;
use goniod_sim::firmware::outbox::WireFault;
use goniod_sim::firmware::sc10::ShutterFault;
use goniod_sim::oracle::read_pixels;
use goniod_sim::twins::Fault;
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::Duration;
use tokio::sync::mpsc;

/// A diffuse sample with both cameras, all kinds of geometry, darks and references in between.
const SCAN: &str = r#"
name = "labels"
[sample]
thickness_mm = 4.0
simulated = "../sim/samples/rough_glass.toml"
[incidence]
directions = [[0, 180], [35, 20], [60, 200]]
sides = ["transmission-front", "reflection-front", "reflection-back"]
[bands]
use = ["f3", "f5", "nir1"]
[exposure]
policy = "ladder"
ratio = 8.0
shortest_s = 0.003
longest_s = 2.0
[dark]
every_directions = 4
frames = 1
[reference]
every_directions = 4
"#;

/// Reasons of all rejections in the journal, with their steps.
fn rejections(files: &Files) -> Vec<(u32, String)> {
    let events = files.dir.with(|j| j.events()).unwrap();
    let parsed = events.iter().filter_map(|e| serde_json::from_str::<Event>(&e.json).ok());
    parsed
        .filter_map(|e| match e {
            Event::FrameRejected { step, reason } => Some((step, format!("{reason:?}"))),
            _ => None,
        })
        .collect()
}

/// Rehearses through the command line and judges the files.
fn rehearsed(lab: &Lab) -> Files {
    let scan = lab.scan("labels.toml", SCAN);
    Files::open(&lab.rehearse(&scan, "runs", &["--no-products"])).unwrap()
}

/// Runs the night as `goniod rehearse` does, with faults put into the bench before it begins.
async fn night_with(lab: &Lab, scan: &str, faults: impl FnOnce(&Faults)) -> (PathBuf, u32) {
    let scan = lab.scan("faults.toml", scan);
    let options = Options { drivers: Vec::new(), today: jiff::civil::date(2026, 3, 4) };
    let checked = check(&scan, &lab.instrument(), &options).unwrap();
    let clock = Clock::starting_at(UtcMicros(1_770_000_000_000_000));
    let plan = night::plan(&checked).unwrap();
    let mut opened = open_simulated(&checked, &Rehearsal::default(), clock).unwrap();
    faults(opened.faults.as_ref().unwrap());
    let night = night::prepare(&checked, plan, &lab.path("runs"), clock, opened.seed).unwrap();
    let (_verbs, asked) = mpsc::channel(1);
    let outcome = night::measure(&checked, &night, &mut opened, clock, asked, &EventBus::default()).await.unwrap();
    assert!(outcome.is_safe(), "{outcome:?}");
    let left: usize = opened.faults.as_ref().unwrap().cameras.values().map(|q| q.len()).sum();
    assert_eq!(left, 0, "every fault has happened");
    (night.path, outcome.summary.rejected)
}

fn nothing_wrong(verdict: &Verdict) {
    assert!(verdict.is_clean(), "{}", verdict.lines().join("\n"));
}

#[test]
fn a_good_night_has_no_wrong_label() {
    let lab = Lab::small();
    let files = rehearsed(&lab);
    let verdict = files.judge().unwrap();
    nothing_wrong(&verdict);
    assert_eq!((verdict.stored, verdict.missing), (files.document.plan.steps.len(), 0));
    eprintln!("{} frames, 0 wrong labels", verdict.stored);
}

/// Cameras that run free and are three frames late with every setting.
#[test]
fn free_running_cameras_that_are_late_have_no_wrong_label() {
    let lab = Lab::small();
    lab.free_running(3);
    let files = rehearsed(&lab);
    let verdict = files.judge().unwrap();
    nothing_wrong(&verdict);
    assert_eq!(verdict.missing, 0);
    eprintln!("{} frames, 0 wrong labels", verdict.stored);
}

/// The oracle's own proof: a label that is changed by hand is found.
#[test]
fn the_oracle_finds_every_kind_of_wrong_label() {
    let lab = Lab::small();
    let files = rehearsed(&lab);
    let (step, view) = files.steps().find(|(_, v)| v.band.as_deref() == Some("f5")).unwrap();
    let pixels = files.pixels(step, view).unwrap();
    let truth = read_pixels(&pixels, 352, 256).unwrap();
    let id = u64::from(truth.frame);
    let count = |step: &Step, view: &View, id: u64| differences(&truth, (step, view), id).len();
    assert_eq!(count(step, view, id), 0);
    let changed: [fn(&mut View); 5] = [
        |v| v.tilt_deg += 0.01,
        |v| v.spin_deg -= 0.01,
        |v| v.changer_deg = v.changer_deg.map(|c| c + 1.0),
        |v| v.slot.0 += 1,
        |v| v.subject = Subject::Dark,
    ];
    for change in changed {
        let mut other = view.clone();
        change(&mut other);
        assert_eq!(count(step, &other, id), 1, "{other:?}");
    }
    assert_eq!(count(&Step { exposure: ExposureTime(step.exposure.0 + 1), ..step.clone() }, view, id), 1);
    assert_eq!(count(step, view, id + 1), 1);
}

/// Most of what is well exposed in one of two frames is so in both: neither black nor saturated pixels hide a change.
fn are_well_exposed(a: &BracketFrame, b: &BracketFrame, levels: u32) -> bool {
    let well = |level: u16| (0.11..0.9).contains(&(f64::from(level) / f64::from(levels)));
    let count = |both: fn(bool, bool) -> bool| {
        a.levels.iter().zip(&b.levels).filter(|(a, b)| both(well(**a), well(**b))).count()
    };
    let both = count(|a, b| a && b);
    both >= 64 && 2 * both >= count(|a, _| a) && 2 * both >= count(|_, b| b)
}

/// A view and the frames of its bracket with their steps.
type Taken<'a> = (&'a View, Vec<(&'a Step, BracketFrame)>);

/// The frames of every lit bracket, shortest exposure first.
fn brackets(files: &Files) -> Vec<Taken<'_>> {
    let mut brackets: BTreeMap<u32, Taken<'_>> = BTreeMap::new();
    for (step, view) in files.steps().filter(|(_, v)| v.subject != Subject::Dark) {
        let (pixels, first) = (files.pixels(step, view).unwrap(), files.reserved_pixels(view));
        let frame = BracketFrame::of(step.exposure.0, pixels.len() - first, |i| pixels.level(first + i));
        brackets.entry(view.id).or_insert((view, Vec::new())).1.push((step, frame));
    }
    let mut brackets: Vec<_> = brackets.into_values().collect();
    brackets.iter_mut().for_each(|(_, frames)| frames.sort_by_key(|(step, _)| step.exposure));
    brackets
}

/// Without the painting: what the second look of the oracle says of a run's pictures when the frames of neighbouring
/// exposures change places, one is stored again for its neighbour, or one has half or twice its light.
#[test]
fn swapped_repeated_and_wrongly_exposed_frames_are_found_without_the_painting() {
    let lab = Lab::small();
    let files = rehearsed(&lab);
    let (mut fits, mut little, mut tried, mut found) = (0, 0, 0, 0);
    for (view, frames) in brackets(&files) {
        let camera = &files.document.instrument.camera[&view.camera];
        let sensor = Sensor::of(camera, &files.document.calibrations[&view.camera]).unwrap();
        for pair in frames.windows(2) {
            let [(_, short), (_, long)] = pair else { unreachable!("windows of two") };
            match sensor.compare(short, long) {
                Told::Contradicts(why) => panic!("view {}: {why}", view.id),
                Told::Little => little += 1,
                Told::Fits => {
                    fits += 1;
                    // What is black or saturated looks the same at other exposures: its neighbours tell.
                    if !are_well_exposed(short, long, camera.format.levels()) {
                        continue;
                    }
                    let labelled =
                        |us: u64, of: &BracketFrame| BracketFrame { exposure_us: us, levels: of.levels.clone() };
                    let (s, l) = (short.exposure_us, long.exposure_us);
                    for (a, b) in [
                        (labelled(s, long), labelled(l, short)),
                        (labelled(s, short), labelled(l, short)),
                        (labelled(s, long), labelled(l, long)),
                        (labelled(s, short), labelled(2 * l, long)),
                        (labelled(s, short), labelled(l / 2, long)),
                    ] {
                        tried += 1;
                        found += usize::from(matches!(sensor.compare(&a, &b), Told::Contradicts(_)));
                    }
                }
            }
        }
    }
    eprintln!("{fits} pairs fit, {little} tell little; {found} of {tried} changed ones are found");
    assert!(fits > 40 && tried >= 20, "{fits} {tried}");
    assert_eq!(found, tried);
}

/// The same from the files: the oracle reads a run in which somebody exchanged two chunks.
#[test]
fn the_oracle_finds_exchanged_chunks_by_their_levels_alone() {
    let lab = Lab::small();
    let files = rehearsed(&lab);
    let run = files.dir.path().to_owned();
    assert_eq!(judge(&run).unwrap().off_response, Vec::<String>::new());
    let levels = |view: &View| files.document.instrument.camera[&view.camera].format.levels();
    let well = |view: &View, pair: &[(&Step, BracketFrame)]| are_well_exposed(&pair[0].1, &pair[1].1, levels(view));
    let all = brackets(&files);
    let mut pairs = all.iter().flat_map(|(view, frames)| frames.windows(2).map(move |pair| (*view, pair)));
    let (view, pair) = pairs.find(|(view, pair)| well(view, pair)).unwrap();
    let chunk = |(step, _): &(&Step, BracketFrame)| {
        files.dir.frames().chunk_path(&view.camera, view.array_index, step.exposure_index)
    };
    let (one, other) = (chunk(&pair[0]), chunk(&pair[1]));
    let (a, b) = (std::fs::read(&one).unwrap(), std::fs::read(&other).unwrap());
    std::fs::write(&one, b).unwrap();
    std::fs::write(&other, a).unwrap();
    assert!(!judge(&run).unwrap().off_response.is_empty());
}

/// Every kind of camera fault, again and again through the night, on the first, the middle and the last frame of
/// brackets.
#[tokio::test(start_paused = true)]
async fn lying_cameras_leave_no_wrong_label() {
    let lab = Lab::small();
    let kinds = [
        CameraFault::Stale,
        CameraFault::Black,
        CameraFault::Truncated,
        CameraFault::SkippedId,
        CameraFault::Late(Duration::from_secs(3)),
        CameraFault::NoFrame,
        CameraFault::Lost,
    ];
    let mut count = 0;
    let (run, rejected) = night_with(&lab, SCAN, |faults| {
        for (name, gaps) in [("ccd", [3, 7, 2, 5]), ("ingaas", [4, 2, 3, 1])] {
            for (n, kind) in kinds.iter().cycle().take(if name == "ccd" { 28 } else { 14 }).enumerate() {
                faults.cameras[name].pass(gaps[n % 4]);
                faults.cameras[name].push(*kind);
                count += 1;
            }
        }
    })
    .await;
    let files = Files::open(&run).unwrap();
    let verdict = files.judge().unwrap();
    nothing_wrong(&verdict);
    let rejections = rejections(&files);
    assert_eq!(rejections.len(), rejected as usize, "the journal tells each rejected frame");
    for reason in ["Repeated", "Black", "Damaged"] {
        assert!(rejections.iter().any(|(_, why)| why.starts_with(reason)), "no frame was rejected as {reason}");
    }
    assert_eq!(verdict.missing, 0, "each was taken again");
    assert!(verify(&run).unwrap().whole());
    assert!(verdict.alike < count / 4, "{} frames without light came for others", verdict.alike);
    eprintln!(
        "{count} faults, {rejected} frames rejected, {} stored, 0 wrong labels; {} black frames for black ones",
        verdict.stored, verdict.alike
    );
}

/// A sensor that still integrates the time of another exposure of the ladder, on each place of the lit brackets of one
/// scan. Darks and frames without light look the same at every exposure, so they are left alone.
#[tokio::test(start_paused = true)]
async fn a_sensor_with_another_exposure_than_it_says_leaves_no_wrong_label() {
    let scan = r#"
name = "exposures"
[sample]
thickness_mm = 4.0
simulated = "../sim/samples/lambertian_t20.toml"
[incidence]
directions = [[0, 180], [40, 180], [60, 0]]
sides = ["transmission-front"]
[bands]
use = ["f3", "f5"]
[exposure]
policy = "ladder"
ratio = 4.0
shortest_s = 0.12
longest_s = 2.0
[dark]
frames = 1
"#;
    for wrong in [ExposureTime(125_000), ExposureTime(500_000), ExposureTime(2_000_000)] {
        for first in 3..7 {
            let lab = Lab::small();
            let (run, rejected) = night_with(&lab, scan, |faults| {
                faults.cameras["ccd"].pass(first);
                for _ in 0..4 {
                    faults.cameras["ccd"].push(CameraFault::WrongExposure(wrong));
                    faults.cameras["ccd"].pass(6);
                }
            })
            .await;
            let files = Files::open(&run).unwrap();
            let verdict = files.judge().unwrap();
            nothing_wrong(&verdict);
            assert_eq!(verdict.missing, 0, "each was taken again: {:?}", rejections(&files));
            // At most two of the four faults meet the exposure that they pretend.
            assert!(rejected >= 2, "{rejected} rejected: {:?}", rejections(&files));
            assert!(verify(&run).unwrap().whole());
        }
    }
}

/// Moving parts that trip, lose bytes or are turned by hand in the middle of the night.
#[tokio::test(start_paused = true)]
async fn moving_parts_that_fail_leave_no_wrong_label() {
    let lab = Lab::small();
    let (run, _) = night_with(&lab, SCAN, |faults| {
        let twins = faults.twins.clone();
        tokio::spawn(async move {
            for round in 0..6 {
                tokio::time::sleep(Duration::from_millis(31_700)).await;
                twins.inject(match round {
                    0 => Fault::Wheel(WheelFault::Button(1)),
                    1 => Fault::Shutter(ShutterFault::FrontKey),
                    2 => Fault::Wheel(WheelFault::Wire(WireFault::NoReply)),
                    3 => Fault::Wheel(WheelFault::Restart),
                    4 => Fault::Unplugged("sim:holder".to_owned(), Duration::from_secs(2)),
                    _ => Fault::Shutter(ShutterFault::Wire(WireFault::Cut(2))),
                });
            }
        });
    })
    .await;
    let files = Files::open(&run).unwrap();
    let verdict = files.judge().unwrap();
    nothing_wrong(&verdict);
    assert_eq!(verdict.missing, 0);
    let events = files.dir.with(|j| j.events()).unwrap();
    let errors = events.iter().filter(|e| e.kind == "device-error").count();
    assert!(errors >= 2, "the journal tells what the devices did: {errors}");
}
