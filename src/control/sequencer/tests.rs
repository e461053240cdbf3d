//! Whole runs on a bench in memory: each exposure stored once under its true label, or missing with the reason; the
//! bench safe at every end.
#![allow(clippy::unwrap_used, clippy::expect_used)]

use super::fakes::{self, DARK_SLOT, HEIGHT, RESERVED, Shared, WIDTH, Wrong};
use super::recovery::Policies;
use super::state::Ending;
use super::verbs::Verb;
use super::{Job, Outcome, run};
use crate::archive::disk::{Disk, RealDisk};
use crate::archive::rows::StepState;
use crate::archive::verify::verify;
use crate::archive::{ArrayLayout, NewRun, RunDir, RunLayout, StepLayout};
use crate::config::instrument::SafeState;
use crate::control::events::{Event, EventBus};
use crate::control::plan::{Forecast, FrameArray, Plan, Step, Subject, View};
use crate::engine::optics::direction::Direction;
use crate::engine::optics::side::Side;
use goniod_drivers::clock::{Clock, UtcMicros};
use goniod_drivers::error::ErrorKind;
use goniod_drivers::frame::{PixelFormat, Pixels};
use goniod_drivers::units::{ExposureTime, Slot};
use std::collections::BTreeMap;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;
use tokio::sync::mpsc;

const EXPOSURES_US: [u64; 3] = [10_000, 40_000, 160_000];
const FOR_EVER: u32 = u32::MAX;

pub(super) fn view(id: u32, array_index: u32, camera: &str, slot: u8, tilt_deg: f64) -> View {
    let dark = slot == DARK_SLOT.0;
    let incident = Direction::from_degrees(0.0, 0.0);
    let sample = Subject::Sample { side: Side::TransmissionFront, incident };
    View {
        id,
        array_index,
        camera: camera.to_owned(),
        subject: if dark { Subject::Dark } else { sample },
        repeat: 0,
        band: None,
        slot: Slot(slot),
        tilt_deg,
        spin_deg: 0.0,
        changer_deg: None,
    }
}

/// A dark, three views of the CCD and one of the InGaAs camera, three exposures each: 15 steps.
pub(super) fn plan() -> Plan {
    let views = vec![
        view(0, 0, "ccd", DARK_SLOT.0, 180.0),
        view(1, 1, "ccd", 1, 180.0),
        view(2, 2, "ccd", 2, 180.0),
        view(3, 0, "ingaas", 9, 150.0),
        view(4, 3, "ccd", 2, 150.0),
    ];
    let mut steps = Vec::new();
    for v in &views {
        for (exposure_index, us) in (0..).zip(EXPOSURES_US) {
            let number = steps.len() as u32;
            steps.push(Step { number, view: v.id, exposure_index, exposure: ExposureTime(us) });
        }
    }
    let array = |camera: &str, views| FrameArray { camera: camera.to_owned(), views, exposures: 3 };
    Plan {
        hash: "h".into(),
        views,
        steps,
        forecast: Forecast::default(),
        arrays: vec![array("ccd", 4), array("ingaas", 1)],
    }
}

pub(super) fn layout_of(plan: &Plan) -> RunLayout {
    let array = |a: &FrameArray| ArrayLayout {
        camera: a.camera.clone(),
        views: a.views,
        exposures: a.exposures,
        rows: HEIGHT,
        columns: WIDTH,
        format: PixelFormat::Mono8,
    };
    let step = |s: &Step| {
        let v = &plan.views[s.view as usize];
        StepLayout {
            number: s.number,
            view: s.view,
            camera: v.camera.clone(),
            array_index: v.array_index,
            exposure_index: s.exposure_index,
            exposure_us: s.exposure.0,
        }
    };
    RunLayout {
        plan_hash: plan.hash.clone(),
        arrays: plan.arrays.iter().map(array).collect(),
        steps: plan.steps.iter().map(step).collect(),
    }
}

pub(super) struct Night {
    pub(super) outcome: Outcome,
    pub(super) world: Shared,
    pub(super) path: PathBuf,
    pub(super) events: Vec<Event>,
    pub(super) _runs: tempfile::TempDir,
}

/// One night on the fake bench: faults set by `prepare`, a verb asked for after a time, frames going to `disk`.
async fn night(prepare: impl FnOnce(&mut fakes::World), asked: Option<(Duration, Verb)>, disk: Arc<dyn Disk>) -> Night {
    let plan = plan();
    let runs = tempfile::tempdir().unwrap();
    let new = NewRun { run_id: "night", plan_toml: "name = \"test\"\n", files: &[], layout: &layout_of(&plan) };
    let archive = Arc::new(RunDir::create_on(runs.path(), &new, disk).unwrap());
    let clock = Clock::starting_at(UtcMicros(1_700_000_000_000_000));
    let (mut bench, world) = fakes::bench(clock);
    prepare(&mut world.lock().unwrap());
    let (verbs, asked_for) = mpsc::channel(4);
    let asking = tokio::spawn(async move {
        if let Some((after, verb)) = asked {
            tokio::time::sleep(after).await;
            verbs.send(verb).await.unwrap();
        }
        // Keep the channel open: an operator who asks nothing is still there.
        std::future::pending::<()>().await;
    });
    let path = archive.path().to_path_buf();
    let outcome = carry_out(&plan, &mut bench, archive, clock, asked_for).await;
    asking.abort();
    let run = RunDir::open(&path).unwrap();
    let rows = run.with(|j| j.events()).unwrap();
    let events = rows.iter().map(|row| serde_json::from_str(&row.json).unwrap()).collect();
    Night { outcome, world, path, events, _runs: runs }
}

pub(super) fn job(plan: &Plan) -> Job<'_> {
    let order = ["shutter", "filter_wheel", "tilt", "spin", "changer", "cameras"].map(str::to_owned).to_vec();
    Job {
        plan,
        gains: [("ccd".to_owned(), 0.0), ("ingaas".to_owned(), 0.0)].into(),
        reserved_rows: [("ccd".to_owned(), RESERVED), ("ingaas".to_owned(), RESERVED)].into(),
        safe_state: SafeState { order, limit_s: 10.0 },
        attempts: Job::ATTEMPTS,
        recovery: Policies::default(),
        interlocks: None,
        light: crate::control::sequencer::light::LightRules::default(),
        serials: BTreeMap::new(),
    }
}

/// A run directory for a plan, in a folder that lives as long as the first of both.
pub(super) fn begun(plan: &Plan) -> (tempfile::TempDir, Arc<RunDir>) {
    let runs = tempfile::tempdir().unwrap();
    let new = NewRun { run_id: "night", plan_toml: "", files: &[], layout: &layout_of(plan) };
    let archive = RunDir::create(runs.path(), &new).unwrap();
    (runs, Arc::new(archive))
}

async fn carry_out(
    plan: &Plan,
    bench: &mut crate::control::devices::bench::Bench,
    archive: Arc<RunDir>,
    clock: Clock,
    verbs: mpsc::Receiver<Verb>,
) -> Outcome {
    let job = job(plan);
    run(&job, bench, archive, clock, verbs, &EventBus::default()).await.unwrap()
}

/// The truth painted into every stored frame against the plan; gives how many there are.
pub(super) fn stored_under_true_labels(path: &Path) -> usize {
    let (plan, run) = (plan(), RunDir::open(path).unwrap());
    let mut stored = 0;
    for row in run.with(|j| j.steps()).unwrap() {
        let at = &row.layout;
        let frame = run.frames().read_frame(&at.camera, at.array_index, at.exposure_index).unwrap();
        if row.state != StepState::Stored {
            continue;
        }
        let Some(Pixels::U8(v)) = frame else { panic!("step {} has no frame", at.number) };
        let view = &plan.views[at.view as usize];
        let exposure = u32::from_le_bytes([v[0], v[1], v[2], v[3]]);
        assert_eq!(u64::from(exposure), at.exposure_us, "step {}", at.number);
        assert_eq!(v[4], 0, "step {}: a black frame that was none", at.number);
        assert_eq!(v[5] == 1, view.subject != Subject::Dark, "step {}: shutter", at.number);
        assert_eq!((v[6], v[7]), (view.slot.0, view.tilt_deg as u8), "step {}: pose", at.number);
        stored += 1;
    }
    stored
}

pub(super) fn is_safe(night: &Night) {
    let world = night.world.lock().unwrap();
    assert!(!world.open, "the shutter is closed");
    assert_eq!(world.slot, Some(DARK_SLOT), "the wheel is dark");
    assert_eq!(world.moved_in_light, 0, "nothing moved with the shutter open");
}

pub(super) fn counts(outcome: &Outcome) -> (u32, u32, u32) {
    (outcome.summary.stored, outcome.summary.missing, outcome.summary.planned)
}

#[tokio::test(start_paused = true)]
async fn a_good_night_stores_every_planned_exposure_and_ends_safe() {
    let night = night(|_| (), None, Arc::new(RealDisk)).await;
    assert_eq!(night.outcome.ending, Ending::Completed);
    assert_eq!(counts(&night.outcome), (15, 0, 0));
    assert_eq!(night.outcome.summary.rejected, 0, "{:?}", night.events);
    assert!(night.outcome.is_safe());
    is_safe(&night);
    assert_eq!(night.world.lock().unwrap().safe[0], "shutter");
    assert_eq!(stored_under_true_labels(&night.path), 15);
    let report = verify(&night.path).unwrap();
    assert!(report.whole(), "{report:?}");
    assert!(matches!(night.events.last(), Some(Event::RunEnded { ending: Ending::Completed, stored: 15, .. })));
}

#[tokio::test(start_paused = true)]
async fn no_wrong_frame_is_ever_kept_and_each_is_counted() {
    let mut total = 0;
    for wrong in [Wrong::Stale, Wrong::OldPixels, Wrong::Skipped, Wrong::Black, Wrong::OtherExposure, Wrong::Damaged] {
        // Frame 2 k of the CCD is the one kept of its k-th exposure while nothing is rejected; frame 10 belongs to the
        // second exposure of the first sample view.
        let prepare = |world: &mut fakes::World| {
            world.wrong.insert(("ccd".to_owned(), 10), wrong);
        };
        let night = night(prepare, None, Arc::new(RealDisk)).await;
        assert_eq!(counts(&night.outcome), (15, 0, 0), "{wrong:?}");
        let rejections = night.events.iter().filter(|e| matches!(e, Event::FrameRejected { .. })).count();
        assert!(rejections >= 1, "{wrong:?} passed");
        assert_eq!(night.outcome.summary.rejected as usize, rejections, "{wrong:?}");
        assert_eq!(stored_under_true_labels(&night.path), 15, "{wrong:?}");
        assert!(verify(&night.path).unwrap().whole());
        total += rejections;
    }
    assert!(total >= 6);
}

#[tokio::test(start_paused = true)]
async fn a_camera_that_gives_no_good_frame_leaves_its_exposure_missing_with_the_reason() {
    let prepare = |world: &mut fakes::World| {
        for number in 7..=14 {
            world.wrong.insert(("ccd".to_owned(), number), Wrong::Damaged);
        }
    };
    let night = night(prepare, None, Arc::new(RealDisk)).await;
    assert_eq!(counts(&night.outcome), (14, 1, 0));
    let reason = "no frame passed in 4 attempts; the last: the buffer is damaged or short";
    assert!(night.events.iter().any(|e| matches!(e, Event::StepMissing { step: 3, reason: r, .. } if r == reason)));
    assert!(verify(&night.path).unwrap().whole());
}

#[tokio::test(start_paused = true)]
async fn a_device_lost_once_is_opened_anew_and_nothing_is_missing() {
    for device in ["shutter", "filter_wheel", "tilt", "ccd"] {
        for kind in [ErrorKind::Lost, ErrorKind::Timeout, ErrorKind::Garbled, ErrorKind::Busy] {
            let plan = plan();
            let clock = Clock::starting_at(UtcMicros(0));
            let (_runs, archive) = begun(&plan);
            let path = archive.path().to_path_buf();
            let (mut bench, world) = fakes::bench(clock);
            // In the middle of the night, and the first opening anew fails too.
            let later = Arc::clone(&world);
            tokio::spawn(async move {
                tokio::time::sleep(Duration::from_secs(10)).await;
                later.lock().unwrap().errors.insert(device.to_owned(), [(kind, 2)].into());
            });
            let (_verbs, asked) = mpsc::channel(1);
            let outcome = carry_out(&plan, &mut bench, archive, clock, asked).await;
            assert_eq!(counts(&outcome), (15, 0, 0), "{device} {kind:?}");
            assert!(outcome.is_safe());
            assert!(world.lock().unwrap().errors[device].is_empty(), "{device} {kind:?} was met");
            assert_eq!(stored_under_true_labels(&path), 15, "{device} {kind:?}");
            assert_eq!(world.lock().unwrap().moved_in_light, 0);
        }
    }
}

#[tokio::test(start_paused = true)]
async fn a_camera_lost_for_ever_leaves_its_exposures_missing_and_the_others_stored() {
    let plan = plan();
    let clock = Clock::starting_at(UtcMicros(0));
    let (_runs, archive) = begun(&plan);
    let path = archive.path().to_path_buf();
    let (mut bench, world) = fakes::bench(clock);
    let later = Arc::clone(&world);
    tokio::spawn(async move {
        tokio::time::sleep(Duration::from_secs(8)).await;
        later.lock().unwrap().errors.insert("ingaas".to_owned(), [(ErrorKind::Lost, FOR_EVER)].into());
    });
    let (_verbs, asked) = mpsc::channel(1);
    let outcome = carry_out(&plan, &mut bench, archive, clock, asked).await;
    assert_eq!(outcome.ending, Ending::Completed);
    assert_eq!(counts(&outcome), (12, 3, 0));
    assert!(!outcome.is_safe(), "the lost camera cannot prove anything");
    assert!(!world.lock().unwrap().open);
    assert_eq!(stored_under_true_labels(&path), 12);
    let report = verify(&path).unwrap();
    assert!(report.whole(), "{report:?}");
    let steps = RunDir::open(&path).unwrap().with(|j| j.steps()).unwrap();
    let missing: Vec<_> =
        steps.iter().filter(|s| matches!(&s.state, StepState::Missing(why) if why.contains("ingaas"))).collect();
    assert_eq!(missing.len(), 3);
}

#[tokio::test(start_paused = true)]
async fn a_refusal_or_a_foreign_device_ends_the_run_safely() {
    for kind in [ErrorKind::Refused, ErrorKind::WrongDevice] {
        let prepare = |world: &mut fakes::World| {
            world.errors.insert("tilt".to_owned(), [(kind, 1)].into());
        };
        let night = night(prepare, None, Arc::new(RealDisk)).await;
        assert_eq!(night.outcome.ending, Ending::DeviceRefused);
        assert_eq!(counts(&night.outcome), (0, 0, 15));
        is_safe(&night);
    }
}

#[tokio::test(start_paused = true)]
async fn stop_finishes_the_exposure_and_abort_gives_it_up_both_end_safe_and_can_be_gone_on_with() {
    for (verb, ending) in [(Verb::Stop, Ending::Stopped), (Verb::Abort, Ending::Aborted)] {
        let night = night(|_| (), Some((Duration::from_millis(7_300), verb)), Arc::new(RealDisk)).await;
        assert_eq!(night.outcome.ending, ending);
        let (stored, missing, planned) = counts(&night.outcome);
        assert!(stored > 0 && planned > 0 && missing == 0, "{verb:?}: {stored} stored");
        assert_eq!(stored + planned, 15);
        is_safe(&night);
        let report = verify(&night.path).unwrap();
        assert!(report.sound() && !report.whole());

        let clock = Clock::starting_at(UtcMicros(0));
        let (mut bench, _world) = fakes::bench(clock);
        let archive = Arc::new(RunDir::resume(&night.path).unwrap());
        let (_verbs, asked) = mpsc::channel(1);
        let outcome = carry_out(&plan(), &mut bench, archive, clock, asked).await;
        assert_eq!(counts(&outcome), (15, 0, 0), "{verb:?}");
        assert_eq!(stored_under_true_labels(&night.path), 15);
        assert!(verify(&night.path).unwrap().whole());
    }
}

#[tokio::test(start_paused = true)]
async fn a_pause_closes_the_shutter_and_resume_goes_on() {
    let plan = plan();
    let clock = Clock::starting_at(UtcMicros(0));
    let (_runs, archive) = begun(&plan);
    let (mut bench, world) = fakes::bench(clock);
    let (verbs, asked) = mpsc::channel(1);
    let operator = tokio::spawn(async move {
        tokio::time::sleep(Duration::from_millis(7_300)).await;
        verbs.send(Verb::Pause).await.unwrap();
        tokio::time::sleep(Duration::from_secs(3600)).await;
        let open = world.lock().unwrap().open;
        verbs.send(Verb::Resume).await.unwrap();
        open
    });
    let outcome = carry_out(&plan, &mut bench, archive, clock, asked).await;
    assert_eq!(counts(&outcome), (15, 0, 0));
    assert!(clock.elapsed() > Duration::from_secs(3600));
    assert!(!operator.await.unwrap(), "the shutter was closed in the pause");
}

/// A disk that is full after some frames.
struct SmallDisk(AtomicU32);

impl Disk for SmallDisk {
    fn write_atomic(&self, path: &Path, bytes: &[u8]) -> io::Result<()> {
        if self.0.fetch_add(1, Ordering::SeqCst) >= 7 {
            return Err(io::Error::from_raw_os_error(28));
        }
        RealDisk.write_atomic(path, bytes)
    }
}

#[tokio::test(start_paused = true)]
async fn a_full_disk_ends_the_night_safely_and_leaves_the_rest_planned() {
    let night = night(|_| (), None, Arc::new(SmallDisk(AtomicU32::new(0)))).await;
    assert_eq!(night.outcome.ending, Ending::DiskFull);
    assert_eq!(counts(&night.outcome), (7, 0, 8));
    assert!(night.outcome.message.as_deref().unwrap_or("").contains("the disk is full"));
    is_safe(&night);
    let report = verify(&night.path).unwrap();
    assert!(report.sound(), "{report:?}");
    assert_eq!(stored_under_true_labels(&night.path), 7);
}

#[tokio::test(start_paused = true)]
async fn two_equal_nights_give_byte_equal_journals() {
    let prepare = |world: &mut fakes::World| {
        world.wrong.insert(("ccd".to_owned(), 10), Wrong::Skipped);
    };
    let one = night(prepare, None, Arc::new(RealDisk)).await;
    let two = night(prepare, None, Arc::new(RealDisk)).await;
    for file in ["journal.sqlite", "journal.seal", "plan.toml"] {
        assert_eq!(std::fs::read(one.path.join(file)).unwrap(), std::fs::read(two.path.join(file)).unwrap(), "{file}");
    }
    assert!(!one.path.join("journal.sqlite-wal").exists() && !one.path.join("journal.sqlite-shm").exists());
}
