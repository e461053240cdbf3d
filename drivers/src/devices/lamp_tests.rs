//! The lamp's behaviour over time.
#![allow(clippy::unwrap_used, clippy::expect_used)]

use super::*;

const SECOND: Duration = Duration::from_secs(1);
const MINUTE: Duration = Duration::from_secs(60);

fn lamp() -> (LampModel, Instant) {
    (LampModel::new(LampConfig::default()), Instant::now())
}

/// Reads `light(seconds)` every second for so long; gives the states that followed each other, with the second.
fn watch(model: &mut LampModel, from: Instant, seconds: u32, light: impl Fn(f64) -> f64) -> Vec<(u32, LampState)> {
    let mut states: Vec<(u32, LampState)> = Vec::new();
    for s in 0..=seconds {
        let now = from + SECOND * s;
        model.observe(light(f64::from(s)), false, now);
        let state = model.state(now);
        if states.last().is_none_or(|(_, last)| *last != state) {
            states.push((s, state));
        }
    }
    states
}

#[tokio::test(start_paused = true)]
async fn a_lamp_found_burning_is_trusted_after_the_whole_warm_up() {
    let (mut model, t) = lamp();
    assert_eq!(model.state(t), LampState::Unknown);
    let states = watch(&mut model, t, 400, |_| 1e-3);
    assert_eq!(states, [(0, LampState::Warming(t + 300 * SECOND)), (300, LampState::Steady)]);
    assert!(model.usable(t + 400 * SECOND));
}

#[tokio::test(start_paused = true)]
async fn a_warming_lamp_is_not_steady_while_its_light_still_rises() {
    let config = LampConfig { warm_up: MINUTE, ..LampConfig::default() };
    let mut model = LampModel::new(config);
    let t = Instant::now();
    let states = watch(&mut model, t, 1200, |s| 1e-3 * (1.0 - 0.7 * (-s / 120.0).exp()));
    let (at, state) = states[1];
    assert_eq!((states[0].1, state, states.len()), (LampState::Warming(t + MINUTE), LampState::Steady, 2));
    // The least-squares slope of 1 - 0.7 e^(-t/120 s) over the last 300 s falls below 0.2 %/min at 789 s (computed apart).
    assert!((785..=793).contains(&at), "{at}");
}

#[tokio::test(start_paused = true)]
async fn a_lost_lamp_cools_before_it_may_be_struck_and_warms_up_anew() {
    let (mut model, t) = lamp();
    watch(&mut model, t, 400, |_| 1e-3);
    let out = t + 401 * SECOND;
    watch(&mut model, out, 60, |_| 2e-10);
    assert_eq!(model.state(out + MINUTE), LampState::Cooling(out + 15 * MINUTE));
    assert_eq!((model.state(out + 15 * MINUTE), model.losses()), (LampState::Off, 1));
    let struck = out + 20 * MINUTE;
    let states = watch(&mut model, struck, 400, |_| 0.9e-3);
    assert_eq!(states, [(0, LampState::Warming(struck + 300 * SECOND)), (300, LampState::Steady)]);
    assert_eq!(model.losses(), 1);
}

#[tokio::test(start_paused = true)]
async fn light_from_a_lamp_that_must_still_be_hot_is_not_trusted() {
    let (mut model, t) = lamp();
    let states = watch(&mut model, t, 1300, |s| if s < 60.0 { 0.0 } else { 1e-3 });
    let (cold, warm) = (t + 15 * MINUTE, t + 20 * MINUTE);
    assert_eq!(
        states,
        [(0, LampState::Cooling(cold)), (900, LampState::Warming(warm)), (1200, LampState::Steady)],
        "found out: nobody knows since when"
    );
    assert_eq!(model.burnt(), 400 * SECOND);
}

#[tokio::test(start_paused = true)]
async fn drift_beyond_the_limit_ends_steadiness_and_its_end_restores_it() {
    let (mut model, t) = lamp();
    watch(&mut model, t, 400, |_| 1e-3);
    let from = t + 401 * SECOND;
    let states = watch(&mut model, from, 1500, |s| 1e-3 * (1.0 - 0.01 / 60.0 * s.min(600.0)));
    let kinds: Vec<LampState> = states.iter().map(|s| s.1).collect();
    assert_eq!(kinds, [LampState::Steady, LampState::Drifting, LampState::Steady]);
    assert!(states[1].0 < 300 && states[2].0 > 600, "{states:?}");
}

#[tokio::test(start_paused = true)]
async fn only_watched_burning_is_counted() {
    let (mut model, t) = lamp();
    watch(&mut model, t, 400, |_| 1e-3);
    assert_eq!(model.burnt(), 400 * SECOND);
    // A gap in which it cannot have been out, then one in which it can.
    watch(&mut model, t + 400 * SECOND + 14 * MINUTE, 0, |_| 1e-3);
    assert_eq!(model.burnt(), 400 * SECOND + 14 * MINUTE);
    watch(&mut model, t + 60 * MINUTE, 10, |_| 1e-3);
    assert_eq!(model.burnt(), 410 * SECOND + 14 * MINUTE);
    // Out at some time since the last reading, which is not counted.
    watch(&mut model, t + 62 * MINUTE, 10, |_| 0.0);
    assert_eq!(model.burnt(), 410 * SECOND + 14 * MINUTE);
}

#[tokio::test(start_paused = true)]
async fn a_saturated_reading_burns_but_tells_no_slope() {
    let (mut model, t) = lamp();
    (0..600).for_each(|s| model.observe(1.0, true, t + SECOND * s));
    assert_eq!((model.slope_per_minute(), model.burnt()), (None, 599 * SECOND));
    assert!(!model.usable(t + 10 * MINUTE));
}
