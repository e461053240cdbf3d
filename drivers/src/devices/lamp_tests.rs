//! The lamp's behaviour over time.
#![allow(clippy::unwrap_used, clippy::expect_used)]

use super::*;

const SECOND: Duration = Duration::from_secs(1);
const MINUTE: Duration = Duration::from_secs(60);

fn lamp() -> (LampModel, Instant) {
    (LampModel::new(LampConfig::default(), Duration::ZERO, 0), Instant::now())
}

/// Reads `light(seconds)` every second for so long; gives what happened, with the second.
fn watch(model: &mut LampModel, from: Instant, seconds: u32, light: impl Fn(f64) -> f64) -> Vec<(u32, LampEvent)> {
    let read = |s: u32| model.observe(light(f64::from(s)), false, from + SECOND * s).map(|event| (s, event));
    (0..=seconds).filter_map(read).collect()
}

#[tokio::test(start_paused = true)]
async fn a_lamp_found_burning_is_trusted_after_the_whole_warm_up() {
    let (mut model, t) = lamp();
    assert_eq!(model.state(t), LampState::Unknown);
    let events = watch(&mut model, t, 400, |_| 1e-3);
    assert_eq!(events, [(0, LampEvent::Burns), (300, LampEvent::Steady)]);
    assert!(model.usable(t + 400 * SECOND));
    assert_eq!(model.ignitions(), 1);
}

#[tokio::test(start_paused = true)]
async fn a_warming_lamp_is_not_steady_while_its_light_still_rises() {
    let config = LampConfig { warm_up: MINUTE, ..LampConfig::default() };
    let mut model = LampModel::new(config, Duration::ZERO, 0);
    let t = Instant::now();
    let events = watch(&mut model, t, 1200, |s| 1e-3 * (1.0 - 0.7 * (-s / 120.0).exp()));
    let (at, event) = events[1];
    assert_eq!((events[0].1, event, events.len()), (LampEvent::Burns, LampEvent::Steady, 2));
    // The least-squares slope of 1 - 0.7 e^(-t/120 s) over the last 300 s falls below 0.2 %/min at 789 s (computed apart).
    assert!((785..=793).contains(&at), "{at}");
}

#[tokio::test(start_paused = true)]
async fn a_lost_lamp_is_told_once_and_cannot_be_struck_while_hot() {
    let (mut model, t) = lamp();
    watch(&mut model, t, 400, |_| 1e-3);
    let out = t + 401 * SECOND;
    assert_eq!(model.observe(2e-10, false, out), Some(LampEvent::Lost));
    assert_eq!(model.observe(2e-10, false, out + SECOND), None);
    assert_eq!(model.state(out + MINUTE), LampState::Cooling(out + 15 * MINUTE));
    assert_eq!(model.may(Wish::On, out + MINUTE), Err(Refusal::TooHot(out + 15 * MINUTE)));
    assert_eq!(model.may(Wish::On, out + 15 * MINUTE), Ok(()));
    assert_eq!(model.burnt(out + 60 * MINUTE), 401 * SECOND);
}

#[tokio::test(start_paused = true)]
async fn a_young_lamp_is_not_switched_off_and_a_burning_one_not_struck() {
    let (mut model, t) = lamp();
    assert!(matches!(model.may(Wish::On, t), Err(Refusal::TooHot(_))), "nobody knows when it was switched off");
    model.observe(0.0, false, t);
    assert_eq!(model.may(Wish::On, t + 15 * MINUTE), Ok(()));
    model.switched(Wish::On, t + 15 * MINUTE);
    assert_eq!(model.may(Wish::On, t + 16 * MINUTE), Err(Refusal::Already));
    assert_eq!(model.may(Wish::Off, t + 16 * MINUTE), Err(Refusal::TooYoung(t + 20 * MINUTE)));
    assert_eq!(model.may(Wish::Off, t + 20 * MINUTE), Ok(()));
    assert_eq!(model.state(t + 16 * MINUTE), LampState::Warming(t + 20 * MINUTE));
}

#[tokio::test(start_paused = true)]
async fn drift_beyond_the_limit_ends_steadiness_and_its_end_restores_it() {
    let (mut model, t) = lamp();
    watch(&mut model, t, 400, |_| 1e-3);
    let from = t + 401 * SECOND;
    let events = watch(&mut model, from, 1500, |s| 1e-3 * (1.0 - 0.01 / 60.0 * s.min(600.0)));
    let kinds: Vec<LampEvent> = events.iter().map(|e| e.1).collect();
    assert_eq!(kinds, [LampEvent::Drifting, LampEvent::Steady]);
    assert!(events[0].0 < 300 && events[1].0 > 600, "{events:?}");
}

#[tokio::test(start_paused = true)]
async fn hours_are_counted_over_lives_and_told_when_they_are_many() {
    let config = LampConfig { rated_hours: Some(500.0), ..LampConfig::default() };
    let mut model = LampModel::new(config, Duration::from_secs(499 * 3600), 80);
    let t = Instant::now();
    model.observe(1e-3, false, t);
    assert!(!model.worn(t + 59 * MINUTE) && model.worn(t + 61 * MINUTE));
    assert_eq!(model.ignitions(), 81);
}

#[tokio::test(start_paused = true)]
async fn a_saturated_reading_burns_but_tells_no_slope() {
    let (mut model, t) = lamp();
    assert_eq!(model.observe(1.0, true, t), Some(LampEvent::Burns));
    (0..600).for_each(|s| assert_eq!(model.observe(1.0, true, t + SECOND * s), None));
    assert_eq!(model.slope_per_minute(), None);
    assert!(!model.usable(t + 10 * MINUTE));
}
