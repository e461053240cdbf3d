//! Where a moving part is at any instant: a track of trapezoid motions that remembers its last moves.

use std::collections::VecDeque;
use std::time::Duration;
use tokio::time::Instant;

/// Motions remembered; a query before the first one gives its start.
const REMEMBERED: usize = 256;

/// A part with one coordinate (degrees, places, opening).
#[derive(Debug, Clone)]
pub struct Track {
    moves: VecDeque<Motion>,
}

/// One motion: from an instant on, segments of constant acceleration, then rest.
#[derive(Debug, Clone)]
struct Motion {
    start: Instant,
    from: f64,
    segments: Vec<Segment>,
}

/// A stretch of constant acceleration.
#[derive(Debug, Clone, Copy)]
struct Segment {
    seconds: f64,
    speed: f64,
    acceleration: f64,
}

// === impl Track ===

impl Track {
    /// A part at rest at `position` since `at`.
    pub fn at_rest(position: f64, at: Instant) -> Track {
        Track { moves: VecDeque::from([Motion { start: at, from: position, segments: Vec::new() }]) }
    }

    /// Position at `at`; before the remembered moves, where the first began.
    pub fn position(&self, at: Instant) -> f64 {
        self.state(at).0
    }

    /// True while the part moves at `at`.
    pub fn moving(&self, at: Instant) -> bool {
        self.motion(at).is_some_and(|m| at < m.end())
    }

    /// When the last motion ends.
    pub fn end(&self) -> Option<Instant> {
        self.moves.back().map(Motion::end)
    }

    /// Goes to `target` with a trapezoid of `speed` and `acceleration` (0 = no ramps), from whatever it does at `at`:
    /// a motion under way is led over without a jump in speed.
    pub fn go(&mut self, at: Instant, target: f64, speed: f64, acceleration: f64) {
        let (from, v0) = self.state(at);
        let mut segments = Vec::new();
        let mut x = from;
        let mut v = v0;
        if acceleration > 0.0 {
            let brake = v * v / (2.0 * acceleration);
            let away = v * (target - x) < 0.0 || brake > (target - x).abs() + 1e-12 || v.abs() > speed;
            if v != 0.0 && away {
                segments.push(Segment {
                    seconds: v.abs() / acceleration,
                    speed: v,
                    acceleration: -v.signum() * acceleration,
                });
                x += v.signum() * brake;
                v = 0.0;
            }
        } else {
            v = 0.0;
        }
        segments.extend(trapezoid(target - x, v.abs(), speed, acceleration));
        self.push(Motion { start: at, from, segments });
    }

    /// Brakes from whatever it does at `at`.
    pub fn brake(&mut self, at: Instant, acceleration: f64) {
        let (from, v) = self.state(at);
        let segments = if v == 0.0 || acceleration <= 0.0 {
            Vec::new()
        } else {
            vec![Segment { seconds: v.abs() / acceleration, speed: v, acceleration: -v.signum() * acceleration }]
        };
        self.push(Motion { start: at, from, segments });
    }

    /// Stands dead at `at`, where it is then; `at` may lie ahead.
    pub fn freeze(&mut self, at: Instant) {
        let from = self.position(at);
        self.push(Motion { start: at, from, segments: Vec::new() });
    }

    /// Is moved by another hand, at once, to rest at `position`.
    pub fn jump(&mut self, at: Instant, position: f64) {
        self.push(Motion { start: at, from: position, segments: Vec::new() });
    }

    /// First instant after `from` at which the present motion passes `position`, to a millisecond.
    pub fn passes(&self, from: Instant, position: f64) -> Option<Instant> {
        let end = self.end()?;
        let side = |at: Instant| (self.position(at) - position).signum();
        let begin = side(from);
        let mut at = from;
        while at < end {
            at += Duration::from_millis(1);
            if side(at) != begin {
                return Some(at);
            }
        }
        None
    }

    fn motion(&self, at: Instant) -> Option<&Motion> {
        self.moves.iter().rev().find(|m| m.start <= at).or(self.moves.front())
    }

    fn state(&self, at: Instant) -> (f64, f64) {
        self.motion(at).map_or((0.0, 0.0), |m| m.state(at))
    }

    fn push(&mut self, motion: Motion) {
        while self.moves.pop_back_if(|m| m.start >= motion.start).is_some() {}
        self.moves.push_back(motion);
        if self.moves.len() > REMEMBERED {
            self.moves.pop_front();
        }
    }
}

// === impl Motion ===

impl Motion {
    fn end(&self) -> Instant {
        let seconds: f64 = self.segments.iter().map(|s| s.seconds).sum();
        self.start + Duration::try_from_secs_f64(seconds).unwrap_or_default()
    }

    /// Position and speed.
    fn state(&self, at: Instant) -> (f64, f64) {
        let mut left = at.saturating_duration_since(self.start).as_secs_f64();
        let mut x = self.from;
        for segment in &self.segments {
            let t = left.min(segment.seconds);
            x += segment.speed * t + 0.5 * segment.acceleration * t * t;
            if left < segment.seconds {
                return (x, segment.speed + segment.acceleration * t);
            }
            left -= t;
        }
        (x, 0.0)
    }
}

/// Segments over the signed `distance`, beginning with the speed `v0` towards it.
fn trapezoid(distance: f64, v0: f64, speed: f64, acceleration: f64) -> Vec<Segment> {
    let (d, sign) = (distance.abs(), distance.signum());
    if d < 1e-12 || speed <= 0.0 {
        return Vec::new();
    }
    if acceleration <= 0.0 {
        return vec![Segment { seconds: d / speed, speed: sign * speed, acceleration: 0.0 }];
    }
    let peak = (acceleration * d + 0.5 * v0 * v0).sqrt().min(speed);
    let ramp_up = (peak - v0).max(0.0) / acceleration;
    let ramp_down = peak / acceleration;
    let ramps = 0.5 * (v0 + peak) * ramp_up + 0.5 * peak * ramp_down;
    vec![
        Segment { seconds: ramp_up, speed: sign * v0, acceleration: sign * acceleration },
        Segment { seconds: ((d - ramps) / peak).max(0.0), speed: sign * peak, acceleration: 0.0 },
        Segment { seconds: ramp_down, speed: sign * peak, acceleration: -sign * acceleration },
    ]
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used)]
    use super::*;
    use proptest::prelude::*;

    fn s(seconds: f64) -> Duration {
        Duration::from_secs_f64(seconds)
    }

    #[test]
    fn a_trapezoid_takes_its_time_and_is_remembered() {
        let t0 = Instant::now();
        let mut track = Track::at_rest(0.0, t0);
        track.go(t0, 90.0, 10.0, 20.0);
        assert!((track.end().unwrap() - t0).abs_diff(s(9.5)) < s(1e-6));
        assert!((track.position(t0 + s(0.5)) - 2.5).abs() < 1e-9);
        assert!((track.position(t0 + s(4.75)) - 45.0).abs() < 1e-9);
        assert!(track.moving(t0 + s(9.4)) && !track.moving(t0 + s(9.6)));
        track.go(t0 + s(20.0), 0.0, 10.0, 20.0);
        assert!((track.position(t0 + s(15.0)) - 90.0).abs() < 1e-9);
        assert!((track.position(t0 + s(40.0))).abs() < 1e-9);
        assert!((track.position(t0 + s(4.75)) - 45.0).abs() < 1e-9, "the past stays");
    }

    #[test]
    fn a_short_move_is_a_triangle_and_a_stop_ramps_down() {
        let t0 = Instant::now();
        let mut track = Track::at_rest(5.0, t0);
        track.go(t0, 6.0, 10.0, 4.0);
        assert!((track.end().unwrap() - t0).abs_diff(s(1.0)) < s(1e-6));
        track.go(t0 + s(2.0), 100.0, 10.0, 20.0);
        track.brake(t0 + s(4.0), 20.0);
        assert!((track.position(t0 + s(5.0)) - (6.0 + 2.5 + 15.0 + 2.5)).abs() < 1e-9);
    }

    proptest! {
        #[test]
        fn every_chain_of_moves_ends_at_its_target_and_never_jumps(
            moves in proptest::collection::vec((-200.0..200.0_f64, 0.0..6.0_f64), 1..6)
        ) {
            let t0 = Instant::now();
            let mut track = Track::at_rest(0.0, t0);
            let mut at = t0;
            for (target, wait) in &moves {
                track.go(at, *target, 15.0, 30.0);
                at += s(*wait);
            }
            let end = track.end().unwrap();
            prop_assert!((track.position(end + s(1.0)) - moves.last().unwrap().0).abs() < 1e-6);
            let mut x = track.position(t0);
            let mut t = t0;
            while t < end {
                t += s(0.01);
                let next = track.position(t);
                prop_assert!((next - x).abs() < 15.0 * 0.01 + 1e-6, "jump {} at {:?}", next - x, t - t0);
                x = next;
            }
        }
    }
}
