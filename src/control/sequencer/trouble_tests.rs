//! Nights with trouble: devices lost for long, interlocks, a full disk, panics, and what an operator may ask meanwhile.
#![allow(clippy::unwrap_used, clippy::expect_used)]

use super::fakes::{self, DARK_SLOT, Shared};
use super::interlocks::Reason;
use super::recovery::Policies;
use super::state::{Ending, State};
use super::tests::{Night, begun, counts, is_safe, job, layout_of, plan, stored_under_true_labels};
use super::verbs::Verb;
use super::{Job, Outcome, run};
use crate::archive::disk::{Disk, RealDisk};
use crate::archive::verify::verify;
use crate::archive::{NewRun, RunDir};
use crate::config::night::Interlocks;
use crate::control::devices::safe::SafeResult;
use crate::control::events::{Event, EventBus};
use goniod_drivers::clock::{Clock, UtcMicros};
use goniod_drivers::error::ErrorKind;
use std::io;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use tokio::sync::mpsc;

pub(super) const S: Duration = Duration::from_secs(1);
pub(super) const START_US: i64 = 1_700_000_000_000_000;

/// One night: the job changed by `change`, and `script` playing operator and fate beside it.
pub(super) async fn trouble<F: Future<Output = ()> + Send + 'static>(
    change: impl FnOnce(&mut Job<'_>),
    disk: Arc<dyn Disk>,
    script: impl FnOnce(mpsc::Sender<Verb>, Shared) -> F,
) -> Night {
    let plan = plan();
    let runs = tempfile::tempdir().unwrap();
    let new = NewRun { run_id: "night", plan_toml: "", files: &[], layout: &layout_of(&plan) };
    let archive = Arc::new(RunDir::create_on(runs.path(), &new, disk).unwrap());
    let clock = Clock::starting_at(UtcMicros(START_US));
    let (mut bench, world) = fakes::bench(clock);
    let (verbs, asked) = mpsc::channel(4);
    let fate = tokio::spawn(script(verbs, Arc::clone(&world)));
    let path = archive.path().to_path_buf();
    let mut job = job(&plan);
    change(&mut job);
    let outcome = run(&job, &mut bench, archive, clock, asked, &EventBus::default()).await.unwrap();
    fate.abort();
    if let Err(e) = fate.await {
        assert!(e.is_cancelled(), "the script failed: {e}");
    }
    let rows = RunDir::open(&path).unwrap().with(|j| j.events()).unwrap();
    let events = rows.iter().map(|row| serde_json::from_str(&row.json).unwrap()).collect();
    Night { outcome, world, path, events, _runs: runs }
}

pub(super) fn disk() -> Arc<dyn Disk> {
    Arc::new(RealDisk)
}

/// Seconds after the start of the first event that `wanted` wants.
pub(super) fn when(night: &Night, wanted: impl Fn(&Event) -> bool) -> f64 {
    let rows = RunDir::open(&night.path).unwrap().with(|j| j.events()).unwrap();
    let row = rows.iter().find(|row| wanted(&serde_json::from_str(&row.json).unwrap())).expect("it happened");
    (row.utc_us - START_US) as f64 / 1e6
}

pub(super) fn was_suspended_for(night: &Night, reason: Reason) -> bool {
    let suspended =
        |e: &Event| matches!(e, Event::StateChanged { to: State::Suspended(reasons), .. } if reasons.contains(&reason));
    night.events.iter().any(suspended)
}

pub(super) fn all_is_stored(night: &Night) {
    assert_eq!(night.outcome.ending, Ending::Completed, "{:?}", night.outcome);
    assert_eq!(counts(&night.outcome), (15, 0, 0), "{:?}", night.events);
    assert_eq!(stored_under_true_labels(&night.path), 15);
    assert!(verify(&night.path).unwrap().whole());
    assert_eq!(night.world.lock().unwrap().moved_in_light, 0);
}

#[tokio::test(start_paused = true)]
async fn a_device_lost_for_ten_minutes_suspends_the_run_in_the_safe_state_and_nothing_is_missing() {
    for device in ["tilt", "filter_wheel", "shutter"] {
        let night = trouble(
            |_| (),
            disk(),
            async move |_verbs, world: Shared| {
                tokio::time::sleep(8 * S).await;
                world.lock().unwrap().hung.insert(device.to_owned());
                tokio::time::sleep(590 * S).await;
                let open = world.lock().unwrap().open;
                assert!(!open || device == "shutter", "{device}: dark while it is waited for");
                world.lock().unwrap().hung.clear();
                std::future::pending().await
            },
        )
        .await;
        assert!(was_suspended_for(&night, Reason::DeviceLost), "{device}");
        all_is_stored(&night);
        assert!(night.outcome.is_safe());
    }
}

/// Killed and begun again by itself at three in the morning: a device that is away then is waited for as in mid-run. A run
/// that begins is not held up by what its operator can still see to.
#[tokio::test(start_paused = true)]
async fn a_device_that_is_away_when_a_run_is_gone_on_with_is_waited_for() {
    for device in ["tilt", "filter_wheel", "shutter"] {
        let night = trouble(
            |_| (),
            disk(),
            async |verbs: mpsc::Sender<Verb>, _| {
                tokio::time::sleep(8 * S).await;
                verbs.send(Verb::Stop).await.unwrap();
                std::future::pending().await
            },
        )
        .await;
        let (stored, 0, left) = counts(&night.outcome) else { panic!("{:?}", night.outcome) };
        assert!(stored > 0 && left > 0);
        let again = again_without(&night.path, device, 600 * S).await;
        assert_eq!((again.ending, counts(&again)), (Ending::Completed, (15, 0, 0)), "{device}: {:?}", again.message);
        assert!(again.is_safe() && verify(&night.path).unwrap().whole());
        assert_eq!(stored_under_true_labels(&night.path), 15, "{device}");

        let (_runs, begun) = begun(&plan());
        let path = begun.path().to_path_buf();
        drop(begun);
        let first = again_without(&path, device, 600 * S).await;
        assert_eq!((first.ending, counts(&first)), (Ending::NotReady, (0, 0, 15)), "{device}");
    }
}

/// Goes on with a run whose device is away for a while.
async fn again_without(path: &Path, device: &str, away: Duration) -> Outcome {
    let (plan, clock) = (plan(), Clock::starting_at(UtcMicros(START_US)));
    let (mut bench, world) = fakes::bench(clock);
    world.lock().unwrap().hung.insert(device.to_owned());
    let archive = Arc::new(RunDir::resume(path).unwrap());
    let (_verbs, asked) = mpsc::channel(1);
    let back = tokio::spawn(async move {
        tokio::time::sleep(away).await;
        world.lock().unwrap().hung.clear();
    });
    let outcome = run(&job(&plan), &mut bench, archive, clock, asked, &EventBus::default()).await.unwrap();
    back.abort();
    outcome
}

#[tokio::test(start_paused = true)]
async fn a_device_lost_for_ever_ends_the_run_after_its_longest_outage_and_nothing_is_given_away() {
    let night = trouble(
        |_| (),
        disk(),
        async |_verbs, world: Shared| {
            tokio::time::sleep(8 * S).await;
            world.lock().unwrap().hung.insert("tilt".to_owned());
            std::future::pending().await
        },
    )
    .await;
    assert_eq!(night.outcome.ending, Ending::DeviceLost);
    let (stored, missing, left) = counts(&night.outcome);
    assert!(stored > 0 && left > 0 && missing == 0 && stored + left == 15, "what is left can be gone on with");
    let ended_s = when(&night, |e| matches!(e, Event::RunEnded { .. }));
    assert!((1800.0..2400.0).contains(&ended_s), "{ended_s}");
    is_safe(&night);
    let of = |name: &str| night.outcome.safe.iter().find(|r| r.device == name).unwrap().outcome;
    assert_eq!(of("shutter"), SafeResult::Confirmed);
    assert_ne!(of("tilt"), SafeResult::Confirmed);
}

#[tokio::test(start_paused = true)]
async fn a_policy_to_stay_suspended_waits_for_somebody_who_resumes() {
    let policies = "longest_outage_s = 300\nafter_outage = \"suspend\"\n";
    let night = trouble(
        |job| job.recovery = Policies::of(&toml::from_str(policies).unwrap()),
        disk(),
        async |verbs: mpsc::Sender<Verb>, world: Shared| {
            tokio::time::sleep(8 * S).await;
            world.lock().unwrap().hung.insert("tilt".to_owned());
            tokio::time::sleep(7200 * S).await;
            world.lock().unwrap().hung.clear();
            tokio::time::sleep(600 * S).await;
            verbs.send(Verb::Resume).await.unwrap();
            std::future::pending().await
        },
    )
    .await;
    all_is_stored(&night);
    assert!(when(&night, |e| matches!(e, Event::Asked { verb: Verb::Resume, refused: None })) > 7800.0);
}

#[tokio::test(start_paused = true)]
async fn a_view_that_cannot_be_had_is_missing_with_the_reason_and_the_night_goes_on() {
    let night = trouble(
        |_| (),
        disk(),
        async |_verbs, world: Shared| {
            tokio::time::sleep(8 * S).await;
            world.lock().unwrap().errors.insert("tilt".to_owned(), [(ErrorKind::Broken, 4)].into());
            std::future::pending().await
        },
    )
    .await;
    assert_eq!(counts(&night.outcome), (12, 3, 0), "{:?}", night.events);
    assert_eq!(stored_under_true_labels(&night.path), 12);
    let of_view = |e: &&Event| matches!(e, Event::StepMissing { view: 3, reason, .. } if reason.contains("tilt"));
    assert_eq!(night.events.iter().filter(of_view).count(), 3, "the whole view, with its reason");
    assert!(verify(&night.path).unwrap().whole());
}

#[tokio::test(start_paused = true)]
async fn an_axis_switched_off_and_on_is_noticed_by_its_own_evidence_and_homed() {
    for device in ["tilt", "spin"] {
        let night = trouble(
            |_| (),
            disk(),
            async move |_verbs, world: Shared| {
                tokio::time::sleep(8 * S).await;
                world.lock().unwrap().lost_place.insert(device.to_owned());
                std::future::pending().await
            },
        )
        .await;
        all_is_stored(&night);
        assert_eq!(night.world.lock().unwrap().homed, 3, "{device}: two at the start, one again");
    }
}

#[tokio::test(start_paused = true)]
async fn pause_now_gives_the_exposure_up_and_it_is_taken_again() {
    for after_ms in [6_500, 7_000, 7_300, 7_450, 9_000, 11_000, 13_000] {
        let night = trouble(
            |_| (),
            disk(),
            async move |verbs: mpsc::Sender<Verb>, world: Shared| {
                tokio::time::sleep(Duration::from_millis(after_ms)).await;
                verbs.send(Verb::PauseNow).await.unwrap();
                tokio::time::sleep(S).await;
                assert!(!world.lock().unwrap().open, "closed within a second");
                tokio::time::sleep(3600 * S).await;
                verbs.send(Verb::Resume).await.unwrap();
                std::future::pending().await
            },
        )
        .await;
        all_is_stored(&night);
    }
}

#[tokio::test(start_paused = true)]
async fn safe_abort_and_a_panic_reach_the_safe_state_at_once_and_tell_each_device() {
    for (verb, ending) in
        [(Some(Verb::Safe), Ending::MadeSafe), (Some(Verb::Abort), Ending::Aborted), (None, Ending::Crashed)]
    {
        let night = trouble(
            |_| (),
            disk(),
            async move |verbs: mpsc::Sender<Verb>, world: Shared| {
                tokio::time::sleep(Duration::from_millis(7_300)).await;
                match verb {
                    Some(verb) => verbs.send(verb).await.unwrap(),
                    None => world.lock().unwrap().panics = Some("ccd".to_owned()),
                }
                std::future::pending().await
            },
        )
        .await;
        assert_eq!(night.outcome.ending, ending);
        is_safe(&night);
        assert!(night.outcome.is_safe());
        let asked_s = if verb.is_some() {
            7.3
        } else {
            when(&night, |e| matches!(e, Event::StateChanged { to: State::MakingSafe(_), .. }))
        };
        let made_safe_s = when(&night, |e| matches!(e, Event::StateChanged { to: State::Safe(_), .. }));
        assert!(made_safe_s - asked_s <= 10.0, "{ending:?}: {asked_s} {made_safe_s}");
        let told: Vec<_> = night
            .events
            .iter()
            .filter_map(|e| match e {
                Event::SafeState { outcome, began_ms, ended_ms, .. } => Some((*outcome, *began_ms, *ended_ms)),
                _ => None,
            })
            .collect();
        assert_eq!(told.len(), 6, "shutter, wheel, two axes, two cameras");
        assert!(told.iter().all(|(outcome, _, ended)| *outcome == SafeResult::Confirmed && *ended <= 10_000));
        assert!(told[0].1 <= 1000, "the first command within a second");
        assert!(verify(&night.path).unwrap().sound());
    }
}

/// What hangs must not hold up the rest: shutter and cameras are safe although tilt and wheel never answer again.
#[tokio::test(start_paused = true)]
async fn the_safe_state_does_not_wait_for_what_hangs() {
    let night = trouble(
        |job| job.safe_state.order = ["tilt", "filter_wheel", "shutter", "cameras", "spin"].map(str::to_owned).to_vec(),
        disk(),
        async |verbs: mpsc::Sender<Verb>, world: Shared| {
            tokio::time::sleep(Duration::from_millis(7_300)).await;
            world.lock().unwrap().hung.extend(["tilt".to_owned(), "filter_wheel".to_owned()]);
            verbs.send(Verb::Safe).await.unwrap();
            std::future::pending().await
        },
    )
    .await;
    for report in &night.outcome.safe {
        let hangs = ["tilt", "filter_wheel"].contains(&report.device.as_str());
        assert_eq!(report.outcome == SafeResult::Confirmed, !hangs, "{report:?}");
        assert!(hangs || report.ended_ms <= 10_000, "{report:?}");
    }
    assert!(!night.world.lock().unwrap().open);
}

/// What trips, when, and by when the run must be over, seconds.
type Alarm = (fn(&mut fakes::World), f64, f64);

pub(super) fn watched() -> Interlocks {
    Interlocks {
        lamp_drift_warning: Some(0.05),
        lamp_drift_alarm: Some(0.5),
        temperature_warning_c: Some(40.0),
        temperature_alarm_c: Some(55.0),
        door: true,
        ..Interlocks::default()
    }
}

#[tokio::test(start_paused = true)]
async fn a_warning_suspends_until_it_is_gone_and_the_night_goes_on_by_itself() {
    for (reason, trip) in [
        (Reason::Temperature, (|w| w.temperature_c = 45.0) as fn(&mut fakes::World)),
        (Reason::LampUnsteady, |w| w.power_w = 0.8e-3),
    ] {
        let night = trouble(
            |job| job.interlocks = Some(watched()),
            disk(),
            async move |_verbs, world: Shared| {
                tokio::time::sleep(8 * S).await;
                trip(&mut world.lock().unwrap());
                tokio::time::sleep(600 * S).await;
                assert!(!world.lock().unwrap().open);
                (world.lock().unwrap().temperature_c, world.lock().unwrap().power_w) = (20.0, 1e-3);
                std::future::pending().await
            },
        )
        .await;
        assert!(was_suspended_for(&night, reason), "{reason:?}");
        all_is_stored(&night);
    }
}

#[tokio::test(start_paused = true)]
async fn an_alarm_makes_safe_also_before_the_start_and_a_silent_gauge_is_one_after_three_periods() {
    let alarms: [Alarm; 4] = [
        (|w| w.contact_open = true, 0.0, 1.0),
        (|w| w.temperature_c = 60.0, 8.0, 21.0),
        (|w| w.power_w = 0.2e-3, 8.0, 21.0),
        (|w| w.silent.extend(["ccd".to_owned()]), 0.0, 31.0),
    ];
    for (n, (trip, after_s, by_s)) in alarms.into_iter().enumerate() {
        let night = trouble(
            |job| job.interlocks = Some(watched()),
            disk(),
            async move |_verbs, world: Shared| {
                tokio::time::sleep(Duration::from_secs_f64(after_s)).await;
                trip(&mut world.lock().unwrap());
                std::future::pending().await
            },
        )
        .await;
        assert_eq!(night.outcome.ending, Ending::Alarm, "{n}");
        let ended_s = when(&night, |e| matches!(e, Event::RunEnded { .. }));
        assert!(ended_s <= by_s, "{n}: {ended_s}");
        let world = night.world.lock().unwrap();
        assert!(!world.open && world.slot == Some(DARK_SLOT), "{n}");
        assert_eq!(after_s == 0.0, night.outcome.summary.stored == 0, "{n}: nothing is taken under an alarm");
    }
}

/// Until the room is there again nothing can be written.
struct FullFor(Arc<AtomicBool>);

impl Disk for FullFor {
    fn write_atomic(&self, path: &Path, bytes: &[u8]) -> io::Result<()> {
        if self.0.load(Ordering::SeqCst) {
            Err(io::Error::from_raw_os_error(28))
        } else {
            RealDisk.write_atomic(path, bytes)
        }
    }
}

#[tokio::test(start_paused = true)]
async fn a_full_disk_is_waited_for_and_no_frame_is_lost() {
    for full_s in [7, 8, 9, 12] {
        let full = Arc::new(AtomicBool::new(false));
        let disk = Arc::new(FullFor(Arc::clone(&full)));
        let night = trouble(
            |_| (),
            disk,
            async move |_verbs, world: Shared| {
                tokio::time::sleep(full_s * S).await;
                full.store(true, Ordering::SeqCst);
                tokio::time::sleep(600 * S).await;
                assert!(!world.lock().unwrap().open, "dark while the disk is full");
                full.store(false, Ordering::SeqCst);
                std::future::pending().await
            },
        )
        .await;
        assert!(was_suspended_for(&night, Reason::Disk), "{full_s}");
        all_is_stored(&night);
    }
}

#[tokio::test(start_paused = true)]
async fn a_camera_that_hangs_is_noticed_within_exposure_readout_and_two_seconds() {
    let night = trouble(
        |_| (),
        disk(),
        async |_verbs, world: Shared| {
            tokio::time::sleep(8 * S).await;
            world.lock().unwrap().hung.insert("ccd.frame".to_owned());
            tokio::time::sleep(10 * S).await;
            world.lock().unwrap().hung.clear();
            std::future::pending().await
        },
    )
    .await;
    let noticed_s = when(&night, |e| matches!(e, Event::DeviceError { error: ErrorKind::Timeout, .. }));
    // The frame under way when it began to hang, then exposure, read-out and the margin.
    assert!(noticed_s <= 8.0 + 0.2 + 0.16 + 0.03 + 2.0, "{noticed_s}");
    all_is_stored(&night);
}

#[tokio::test(start_paused = true)]
async fn a_run_that_is_gone_on_with_refuses_another_device_than_it_began_with() {
    let night = trouble(
        |job| drop(job.serials.insert("spin".to_owned(), "another".to_owned())),
        disk(),
        async |_verbs, _world| std::future::pending().await,
    )
    .await;
    assert_eq!(night.outcome.ending, Ending::DeviceRefused);
    assert!(night.outcome.message.as_deref().is_some_and(|m| m.contains("the run began with another")));
    is_safe(&night);
}
