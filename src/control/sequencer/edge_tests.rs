//! Edges of a night: its end asked for in every state, twice; what comes after a panic; a listener that never reads; the
//! signs of life of a sequencer that waits.
#![allow(clippy::unwrap_used, clippy::expect_used)]

use super::fakes::{self, DARK_SLOT, Shared};
use super::run;
use super::state::{Ending, State};
use super::tests::{Night, begun, counts, is_safe, job, plan, stored_under_true_labels, view};
use super::trouble_tests::{S, disk, trouble, watched, when};
use super::verbs::Verb;
use crate::archive::RunDir;
use crate::archive::verify::verify;
use crate::control::events::{Event, EventBus};
use crate::control::plan::{Forecast, FrameArray, Plan, Step};
use goniod_drivers::clock::{Clock, UtcMicros};
use goniod_drivers::units::ExposureTime;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;
use tokio::sync::{broadcast, mpsc};

/// How a night gets into a state: what is done to the bench and asked beforehand, and when the end is asked for.
struct Way {
    state: &'static str,
    at: Duration,
    fate: fn(&mut fakes::World),
    before: Option<Verb>,
    asked: Duration,
}

const MS: fn(u64) -> Duration = Duration::from_millis;

fn ways() -> Vec<Way> {
    let nothing: fn(&mut fakes::World) = |_| ();
    let hangs: fn(&mut fakes::World) = |w| w.hung.extend(["tilt".to_owned()]);
    let warm: fn(&mut fakes::World) = |w| w.temperature_c = 45.0;
    vec![
        Way { state: "checking", at: MS(0), fate: hangs, before: None, asked: MS(5_000) },
        Way { state: "running", at: MS(0), fate: nothing, before: None, asked: MS(7_300) },
        Way { state: "pausing", at: MS(7_300), fate: nothing, before: Some(Verb::Pause), asked: MS(7_301) },
        Way { state: "paused", at: MS(7_300), fate: nothing, before: Some(Verb::Pause), asked: MS(20_000) },
        Way { state: "suspended", at: MS(8_000), fate: warm, before: None, asked: MS(100_000) },
        Way { state: "recovering", at: MS(8_000), fate: hangs, before: None, asked: MS(80_000) },
        Way { state: "suspended", at: MS(8_000), fate: hangs, before: None, asked: MS(900_000) },
    ]
}

/// The state in which a verb was asked for, as the journal tells.
fn asked_in(night: &Night, verb: Verb) -> &'static str {
    let at = night.events.iter().position(|e| matches!(e, Event::Asked { verb: v, .. } if *v == verb)).unwrap();
    let before = night.events[..at].iter().rev();
    let state = before.filter_map(|e| if let Event::StateChanged { to, .. } = e { Some(to) } else { None }).next();
    state.map_or("idle", State::name)
}

async fn end_asked(way: &Way, verbs: &'static [Verb]) -> Night {
    let (at, fate, before, asked) = (way.at, way.fate, way.before, way.asked);
    let script = async move |sender: mpsc::Sender<Verb>, world: Shared| {
        tokio::time::sleep(at).await;
        fate(&mut world.lock().unwrap());
        if let Some(verb) = before {
            sender.send(verb).await.unwrap();
        }
        tokio::time::sleep(asked - at).await;
        for verb in verbs {
            // A run that is over takes no more requests.
            let _ = sender.send(*verb).await;
        }
        std::future::pending().await
    };
    trouble(|job| job.interlocks = Some(watched()), disk(), script).await
}

/// Asked once, the exposure under way is finished; asked twice, it is given up. The bench is safe within the limits of its
/// safe state, as far as it answers, and the run can be gone on with.
#[tokio::test(start_paused = true)]
async fn an_end_asked_for_in_any_state_once_or_twice_is_a_safe_end() {
    for way in ways() {
        for verbs in [&[Verb::Stop][..], &[Verb::Stop, Verb::Abort], &[Verb::Abort], &[Verb::Safe]] {
            let night = end_asked(&way, verbs).await;
            let what = format!("{verbs:?} while {} at {:?}", way.state, way.asked);
            if verbs[0] != Verb::Safe {
                assert_eq!(asked_in(&night, verbs[0]), way.state, "{what}");
            }
            let expected: &[Ending] = match verbs {
                [Verb::Stop] => &[Ending::Stopped],
                [Verb::Stop, _] => &[Ending::Stopped, Ending::Aborted],
                [Verb::Abort] => &[Ending::Aborted],
                _ => &[Ending::MadeSafe],
            };
            assert!(expected.contains(&night.outcome.ending), "{what}: {:?}", night.outcome);
            let (stored, missing, left) = counts(&night.outcome);
            assert!(left > 0 && missing == 0 && stored + left == 15, "{what}: {:?}", night.outcome);
            {
                let world = night.world.lock().unwrap();
                assert!(!world.open && world.slot == Some(DARK_SLOT), "{what}");
                assert_eq!(world.moved_in_light, 0, "{what}");
            }
            let ended_s = when(&night, |e| matches!(e, Event::RunEnded { .. }));
            // Each device twice within its limit of 10 s, side by side.
            assert!(ended_s - way.asked.as_secs_f64() <= 26.0, "{what}: {ended_s}");
            assert!(verify(&night.path).unwrap().sound(), "{what}");
            assert_eq!(stored_under_true_labels(&night.path), stored as usize, "{what}");
        }
    }
}

/// Asked for again while the bench is made safe: nothing begins anew, nothing is left out.
#[tokio::test(start_paused = true)]
async fn requests_while_the_bench_is_made_safe_change_nothing() {
    let night = trouble(
        |_| (),
        disk(),
        async |verbs: mpsc::Sender<Verb>, world: Shared| {
            tokio::time::sleep(MS(7_300)).await;
            world.lock().unwrap().hung.insert("tilt".to_owned());
            verbs.send(Verb::Abort).await.unwrap();
            for verb in [Verb::Stop, Verb::Resume, Verb::Pause, Verb::Abort, Verb::Safe] {
                tokio::time::sleep(S).await;
                let _ = verbs.send(verb).await;
            }
            std::future::pending().await
        },
    )
    .await;
    assert_eq!(night.outcome.ending, Ending::Aborted);
    let world = night.world.lock().unwrap();
    assert!(!world.open && world.slot == Some(DARK_SLOT));
    for device in ["shutter", "filter_wheel", "spin", "ccd", "ingaas"] {
        assert_eq!(world.safe.iter().filter(|name| *name == device).count(), 1, "{device}");
    }
}

/// The journal tells of the crash, and the same bench carries the run to its end in the same process.
#[tokio::test(start_paused = true)]
async fn after_a_panic_the_journal_tells_it_and_the_next_run_is_possible() {
    for device in ["ccd", "tilt", "shutter"] {
        let (plan, clock) = (plan(), Clock::starting_at(UtcMicros(0)));
        let (_runs, archive) = begun(&plan);
        let path = archive.path().to_path_buf();
        let (mut bench, world) = fakes::bench(clock);
        let later = Arc::clone(&world);
        tokio::spawn(async move {
            tokio::time::sleep(8 * S).await;
            later.lock().unwrap().panics = Some(device.to_owned());
        });
        let (verbs, asked) = mpsc::channel(1);
        let outcome = run(&job(&plan), &mut bench, archive, clock, asked, &EventBus::default()).await.unwrap();
        drop(verbs);
        assert_eq!(outcome.ending, Ending::Crashed, "{device}");
        let rows = RunDir::open(&path).unwrap().with(|j| j.events()).unwrap();
        let last: Event = serde_json::from_str(&rows.last().unwrap().json).unwrap();
        let told = |m: &String| m.contains("the program failed") && m.contains("as the test wants it");
        assert!(
            matches!(&last, Event::RunEnded { ending: Ending::Crashed, message: Some(m), .. } if told(m)),
            "{last:?}"
        );
        assert!(!world.lock().unwrap().open && verify(&path).unwrap().sound(), "{device}");

        let archive = Arc::new(RunDir::resume(&path).unwrap());
        let (_verbs, asked) = mpsc::channel(1);
        let outcome = run(&job(&plan), &mut bench, archive, clock, asked, &EventBus::default()).await.unwrap();
        assert_eq!((outcome.ending, counts(&outcome)), (Ending::Completed, (15, 0, 0)), "{device}");
        assert_eq!(stored_under_true_labels(&path), 15, "{device}");
        assert!(verify(&path).unwrap().whole(), "{device}");
    }
}

/// Many views of one camera: more events than a listener may fall behind.
fn long_plan() -> Plan {
    let views: Vec<_> = (0..130).map(|id| view(id, id, "ccd", 1 + (id % 8) as u8, 180.0)).collect();
    let mut steps = Vec::new();
    for v in &views {
        for (exposure_index, us) in (0..).zip([10_000, 40_000, 160_000]) {
            let number = steps.len() as u32;
            steps.push(Step { number, view: v.id, exposure_index, exposure: ExposureTime(us) });
        }
    }
    let arrays = vec![FrameArray { camera: "ccd".to_owned(), views: 130, exposures: 3 }];
    Plan { hash: "long".into(), views, steps, forecast: Forecast::default(), arrays }
}

#[tokio::test(start_paused = true)]
async fn a_listener_that_never_reads_holds_nobody_up_and_the_journal_has_everything() {
    let (plan, clock) = (long_plan(), Clock::starting_at(UtcMicros(0)));
    let (_runs, archive) = begun(&plan);
    let path = archive.path().to_path_buf();
    let (mut bench, _world) = fakes::bench(clock);
    let events = EventBus::default();
    let mut listener = events.subscribe();
    let (_verbs, asked) = mpsc::channel(1);
    let outcome = run(&job(&plan), &mut bench, archive, clock, asked, &events).await.unwrap();
    assert_eq!(counts(&outcome), (390, 0, 0));
    drop(events);
    let Err(broadcast::error::RecvError::Lagged(lost)) = listener.recv().await else { panic!("nothing was lost") };
    let mut heard = Vec::new();
    while let Ok(stamped) = listener.recv().await {
        heard.push(stamped.seq);
    }
    assert!(lost > 0 && heard.is_sorted(), "{lost}");
    assert_eq!(*heard.first().unwrap(), lost, "it is told exactly how many it missed");
    let rows = RunDir::open(&path).unwrap().with(|j| j.events()).unwrap();
    assert_eq!(rows.iter().filter(|row| row.kind == "frame-stored").count(), 390);
    assert!(matches!(serde_json::from_str(&rows.last().unwrap().json).unwrap(), Event::RunEnded { .. }));
}

/// A paused or suspended run tells nothing for hours; that it comes round all the same shows that it is not stuck.
#[tokio::test(start_paused = true)]
async fn a_sequencer_that_waits_gives_signs_of_life() {
    let (plan, clock) = (plan(), Clock::starting_at(UtcMicros(0)));
    let (_runs, archive) = begun(&plan);
    let (mut bench, _world) = fakes::bench(clock);
    let (events, (verbs, asked)) = (EventBus::default(), mpsc::channel(1));
    let beats = events.beats();
    let operator = tokio::spawn(async move {
        tokio::time::sleep(MS(7_300)).await;
        verbs.send(Verb::Pause).await.unwrap();
        tokio::time::sleep(60 * S).await;
        let mut seen = beats.load(Ordering::Relaxed);
        for _ in 0..60 {
            tokio::time::sleep(60 * S).await;
            let now = beats.load(Ordering::Relaxed);
            assert!(now > seen, "a minute without a sign of life");
            seen = now;
        }
        verbs.send(Verb::Resume).await.unwrap();
    });
    let outcome = run(&job(&plan), &mut bench, archive, clock, asked, &events).await.unwrap();
    operator.await.unwrap();
    assert_eq!(counts(&outcome), (15, 0, 0));
}

#[tokio::test(start_paused = true)]
async fn an_end_asked_for_before_the_start_takes_no_exposure() {
    let night = trouble(
        |_| (),
        disk(),
        async |verbs: mpsc::Sender<Verb>, _world| {
            verbs.send(Verb::Stop).await.unwrap();
            std::future::pending().await
        },
    )
    .await;
    assert_eq!(night.outcome.ending, Ending::Stopped);
    is_safe(&night);
    assert!(counts(&night.outcome).2 > 0 && verify(&night.path).unwrap().sound());
}
