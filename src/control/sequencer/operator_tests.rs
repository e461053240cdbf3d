//! Nights with a person as changer: asked in the safe state, confirmed, or never confirmed.
#![allow(clippy::unwrap_used, clippy::expect_used)]

use super::fakes::{self, Shared};
use super::interlocks::Reason;
use super::recovery::Policies;
use super::run;
use super::state::{Ending, State};
use super::tests::{Night, begun, counts, is_safe, job, plan};
use super::verbs::Verb;
use crate::archive::RunDir;
use crate::archive::rows::StepState;
use crate::control::events::{Event, EventBus};
use crate::control::plan::Plan;
use goniod_drivers::clock::{Clock, UtcMicros};
use goniod_drivers::devices::AxisConfig;
use goniod_drivers::devices::operator::{Desk, Operator, Place};
use goniod_drivers::units::{Degrees, DegreesPerSecond};
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::mpsc;

const S: Duration = Duration::from_secs(1);
const WITHIN: Duration = Duration::from_secs(900);
const WORDS: [&str; 2] = ["interior side to the camera", "exterior side to the camera"];

/// The first three views show the interior side, the other two the exterior side: 9 and 6 exposures.
fn two_sides() -> Plan {
    let mut plan = plan();
    for (n, view) in plan.views.iter_mut().enumerate() {
        view.changer_deg = Some(if n < 3 { 0.0 } else { 180.0 });
    }
    plan
}

fn operator(desk: Desk) -> Operator {
    let config = AxisConfig {
        name: "changer".into(),
        device: 3,
        axis: 1,
        serial: "hands".into(),
        min: Degrees(0.0),
        max: Degrees(360.0),
        speed: DegreesPerSecond(10.0),
        acceleration_deg_per_s2: 10.0,
        tolerance: Degrees(0.05),
        settle: Duration::ZERO,
    };
    let places = [0.0, 180.0].into_iter().zip(WORDS).map(|(at, words)| Place { at: Degrees(at), words: words.into() });
    Operator::new(config, places.collect(), desk)
}

/// One night with `person` at the desk.
async fn night<F: Future<Output = ()> + Send + 'static>(
    person: impl FnOnce(Desk, mpsc::Sender<Verb>, Shared) -> F,
) -> Night {
    let (plan, desk) = (two_sides(), Desk::default());
    let (runs, archive) = begun(&plan);
    let path = archive.path().to_path_buf();
    let clock = Clock::starting_at(UtcMicros(1_700_000_000_000_000));
    let (mut bench, world) = fakes::bench(clock);
    bench.devices.changer = Some(Box::new(operator(desk.clone())));
    bench.devices.operator = Some(desk.clone());
    let (verbs, asked) = mpsc::channel(4);
    let person = tokio::spawn(person(desk, verbs, Arc::clone(&world)));
    let mut job = job(&plan);
    job.recovery = Policies::default().with_operator(WITHIN);
    let outcome = run(&job, &mut bench, archive, clock, asked, &EventBus::default()).await.unwrap();
    person.abort();
    if let Err(e) = person.await {
        assert!(e.is_cancelled(), "the person failed: {e}");
    }
    let rows = RunDir::open(&path).unwrap().with(|j| j.events()).unwrap();
    let events = rows.iter().map(|row| serde_json::from_str(&row.json).unwrap()).collect();
    Night { outcome, world, path, events, _runs: runs }
}

/// Waits until something is asked, gives it some minutes, and confirms, so many times.
async fn confirms(times: u32, desk: Desk, verbs: mpsc::Sender<Verb>, world: Shared) {
    for _ in 0..times {
        while desk.asked().is_none() {
            tokio::time::sleep(S).await;
        }
        tokio::time::sleep(400 * S).await;
        assert!(!world.lock().unwrap().open, "no beam on the hands");
        assert!(desk.asked().is_some(), "waiting and trying again confirm nothing");
        verbs.send(Verb::Resume).await.unwrap();
        tokio::time::sleep(S).await;
    }
    // Somebody is there and asks nothing more.
    std::future::pending().await
}

/// Sentences of the changer's errors, in their order, each once.
fn questions(night: &Night) -> Vec<String> {
    let mut all: Vec<String> = Vec::new();
    for event in &night.events {
        if let Event::DeviceError { device, message, .. } = event {
            assert_eq!(device, "changer");
            if !all.contains(message) {
                all.push(message.clone());
            }
        }
    }
    all
}

fn suspended(night: &Night) -> bool {
    let waits =
        |e: &Event| matches!(e, Event::StateChanged { to: State::Suspended(r), .. } if r.contains(&Reason::DeviceLost));
    night.events.iter().any(waits)
}

#[tokio::test(start_paused = true)]
async fn an_operator_who_confirms_turns_the_sample_for_the_other_side() {
    let night = night(|desk, verbs, world| confirms(2, desk, verbs, world)).await;
    assert_eq!((night.outcome.ending, counts(&night.outcome)), (Ending::Completed, (15, 0, 0)), "{:?}", night.events);
    let asked = questions(&night);
    assert_eq!(asked.len(), 2, "{asked:?}");
    for (message, words) in asked.iter().zip(WORDS) {
        assert!(message.contains(words) && message.contains("goniod resume"), "{message}");
    }
    assert!(suspended(&night));
    is_safe(&night);
}

#[tokio::test(start_paused = true)]
async fn what_nobody_turns_is_missing_with_the_reason_and_the_rest_is_there() {
    for (times, stored) in [(1, 9), (0, 0)] {
        let night = night(move |desk, verbs, world| confirms(times, desk, verbs, world)).await;
        assert_eq!(night.outcome.ending, Ending::Completed, "{:?}", night.outcome);
        assert_eq!(counts(&night.outcome), (stored, 15 - stored, 0));
        let steps = RunDir::open(&night.path).unwrap().with(|j| j.steps()).unwrap();
        for step in steps {
            match step.state {
                StepState::Stored => assert!(step.layout.view < 3, "{step:?}"),
                // The question that was never answered stands until somebody answers it.
                StepState::Missing(ref reason) => assert!(reason.contains(WORDS[times as usize]), "{step:?}"),
                StepState::Planned => panic!("{step:?}"),
            }
        }
        is_safe(&night);
    }
}
