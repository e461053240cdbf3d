//! The travel order: poses of one changer place follow each other on the cheapest of several ways.

use super::forecast::{Timing, axis_s};
use crate::config::incidence::Incident;
use crate::config::instrument::Instrument;
use crate::config::pose::Pose;
use crate::engine::optics::side::Side;

/// The nearest is looked for among so many targets at most: the search grows with their square.
const MOST_NEAREST: usize = 2_000;

/// One incident direction on one side, with the pose that shows it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Target {
    /// Hemisphere pair.
    pub side: Side,
    /// Incident direction.
    pub incident: Incident,
    /// Axis angles.
    pub pose: Pose,
}

/// Seconds from one pose to another: tilt, spin and changer one after the other.
pub fn travel_s(instrument: &Instrument, timing: &Timing, from: Pose, to: Pose) -> f64 {
    let holder = &instrument.holder;
    let mut total = axis_s(&holder.tilt, from.tilt_deg, to.tilt_deg, timing)
        + axis_s(&holder.spin, from.spin_deg, to.spin_deg, timing);
    if let (Some(changer), Some(a), Some(b)) = (&holder.changer, from.changer_deg, to.changer_deg) {
        total += axis_s(&changer.axis, a, b, timing);
    }
    total
}

/// Seconds of a whole way that begins at `start`.
pub fn way_s(instrument: &Instrument, timing: &Timing, start: Pose, way: &[Target]) -> f64 {
    let mut at = start;
    let mut total = 0.0;
    for target in way {
        total += travel_s(instrument, timing, at, target.pose);
        at = target.pose;
    }
    total
}

/// Orders the targets: changer places one after the other (the sample is turned over once), and within each place the
/// cheapest of: as listed; serpentines by rings of tilt or by meridians of spin, from either end; always the nearest.
pub fn order(instrument: &Instrument, timing: &Timing, start: Pose, targets: &[Target]) -> Vec<Target> {
    let mut places: Vec<Option<f64>> = Vec::new();
    for target in targets {
        if !places.contains(&target.pose.changer_deg) {
            places.push(target.pose.changer_deg);
        }
    }
    let mut at = start;
    let mut way = Vec::with_capacity(targets.len());
    for place in places {
        let group: Vec<Target> = targets.iter().copied().filter(|t| t.pose.changer_deg == place).collect();
        let best = best_way(instrument, timing, at, &group);
        at = best.last().map_or(at, |t| t.pose);
        way.extend(best);
    }
    way
}

fn best_way(instrument: &Instrument, timing: &Timing, start: Pose, group: &[Target]) -> Vec<Target> {
    let tilt = |p: Pose| p.tilt_deg;
    let spin = |p: Pose| p.spin_deg;
    let mut ways = vec![group.to_vec()];
    if group.len() <= MOST_NEAREST {
        ways.push(nearest(instrument, timing, start, group));
    }
    for (outer_up, inner_up) in [(true, true), (true, false), (false, true), (false, false)] {
        ways.push(serpentine(group, tilt, spin, outer_up, inner_up));
        ways.push(serpentine(group, spin, tilt, outer_up, inner_up));
    }
    let costs = ways.into_iter().map(|way| (way_s(instrument, timing, start, &way), way));
    // The first of equals, so that the order is the same every time.
    costs.min_by(|(a, _), (b, _)| a.total_cmp(b)).map(|(_, way)| way).unwrap_or_default()
}

/// Lines of equal `outer` angle, each walked the other way round than the one before.
fn serpentine(
    group: &[Target],
    outer: impl Fn(Pose) -> f64,
    inner: impl Fn(Pose) -> f64,
    outer_up: bool,
    inner_up: bool,
) -> Vec<Target> {
    let directed = |angle: f64, up: bool| if up { angle } else { -angle };
    let mut sorted = group.to_vec();
    sorted.sort_by(|a, b| {
        let key = |t: &Target| (directed(outer(t.pose), outer_up), directed(inner(t.pose), inner_up));
        let ((a0, a1), (b0, b1)) = (key(a), key(b));
        a0.total_cmp(&b0).then(a1.total_cmp(&b1))
    });
    let mut way = Vec::with_capacity(sorted.len());
    for (n, line) in sorted.chunk_by(|a, b| outer(a.pose) == outer(b.pose)).enumerate() {
        if n % 2 == 0 {
            way.extend_from_slice(line);
        } else {
            way.extend(line.iter().rev().copied());
        }
    }
    way
}

fn nearest(instrument: &Instrument, timing: &Timing, start: Pose, group: &[Target]) -> Vec<Target> {
    let mut left = group.to_vec();
    let mut at = start;
    let mut way = Vec::with_capacity(left.len());
    loop {
        let costs = left.iter().enumerate().map(|(n, t)| (travel_s(instrument, timing, at, t.pose), n));
        let Some((_, n)) = costs.min_by(|(a, _), (b, _)| a.total_cmp(b)) else { return way };
        let target = left.remove(n);
        at = target.pose;
        way.push(target);
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::config::scan::{BasisName, Incidence};
    use crate::config::testing::instrument;
    use proptest::prelude::*;

    const HOME: Pose = Pose { tilt_deg: 0.0, spin_deg: 0.0, changer_deg: Some(0.0) };

    fn targets(instrument: &Instrument, sides: &[Side], incidents: &[Incident]) -> Vec<Target> {
        let all = sides.iter().flat_map(|side| incidents.iter().map(move |incident| (*side, *incident)));
        all.map(|(side, incident)| Target {
            side,
            incident,
            pose: Pose::of_sample(instrument, side, incident).unwrap(),
        })
        .collect()
    }

    #[test]
    fn klems_full_is_walked_in_rings_and_turned_over_once() {
        let i = instrument();
        let timing = Timing::default();
        let incidents = Incidence { basis: Some(BasisName::KlemsFull), ..Incidence::default() }.incidents();
        let listed = targets(&i, &Side::ALL, &incidents);
        let way = order(&i, &timing, HOME, &listed);
        assert_eq!(way.len(), 4 * 145);
        let flips = way.windows(2).filter(|w| w[0].pose.changer_deg != w[1].pose.changer_deg).count();
        assert_eq!(flips, 1);
        let (ours, naive) = (way_s(&i, &timing, HOME, &way), way_s(&i, &timing, HOME, &listed));
        assert!(ours < 0.8 * naive, "{ours} against {naive}");
    }

    proptest! {
        /// The way is never longer than the list, loses nothing and invents nothing.
        #[test]
        fn the_way_is_a_permutation_and_not_longer_than_the_list(
            angles in proptest::collection::vec((0.0..89.0f64, 0.0..360.0f64), 1..25),
            back in any::<bool>(),
        ) {
            let i = instrument();
            let timing = Timing::default();
            let sides = if back { vec![Side::TransmissionFront, Side::ReflectionBack] } else { vec![Side::ReflectionFront] };
            let incidents: Vec<Incident> = angles.iter().map(|(t, p)| Incident::new(*t, *p)).collect();
            let listed = targets(&i, &sides, &incidents);
            let way = order(&i, &timing, HOME, &listed);
            prop_assert!(way_s(&i, &timing, HOME, &way) <= way_s(&i, &timing, HOME, &listed) + 1e-9);
            let key = |t: &Target| (t.side, t.incident.theta_deg.to_bits(), t.incident.phi_deg.to_bits());
            let mut a: Vec<_> = way.iter().map(key).collect();
            let mut b: Vec<_> = listed.iter().map(key).collect();
            a.sort();
            b.sort();
            prop_assert_eq!(a, b);
        }
    }
}
