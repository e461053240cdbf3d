//! Which faults a night gets, and when: drawn from a seed, even over all kinds from seed to seed.

use super::catalogue::Kind;
use crate::truth::rng::Key;
use std::fmt;
use std::str::FromStr;
use std::time::Duration;

/// How rough a night is.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Mix {
    /// Nothing happens.
    #[default]
    None,
    /// A few faults that pass by themselves.
    Typical,
    /// Many faults, some at the same time, some that last.
    Nasty,
}

/// A fault to come.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Entry {
    /// Not before this time of the night.
    pub at: Duration,
    /// What happens.
    pub kind: Kind,
    /// Its details (which camera, which byte) are drawn from this.
    pub draw: Key,
}

/// The faults of one night in their order.
#[derive(Debug, Clone, PartialEq)]
pub struct Schedule {
    /// The faults.
    pub entries: Vec<Entry>,
}

/// Faults of a typical night.
const TYPICAL: usize = 6;
/// Faults of a nasty night.
const NASTY: usize = 24;
/// Share of a nasty night's faults that come together with the one before.
const TOGETHER: f64 = 0.2;

// === impl Schedule ===

impl Schedule {
    /// The faults of a night that would last `span`, on a bench with or without a light monitor.
    pub fn of(mix: Mix, light_monitor: bool, seed: u64, span: Duration) -> Schedule {
        let with_light = |mut kinds: Vec<Kind>| {
            kinds.extend(Kind::of_the_light().into_iter().filter(|_| light_monitor));
            mixed(kinds)
        };
        match mix {
            Mix::None => Schedule { entries: Vec::new() },
            Mix::Typical => Schedule::draw(&with_light(Kind::transient()), TYPICAL, 0.0, seed, span),
            Mix::Nasty => Schedule::draw(&with_light(Kind::all()), NASTY, TOGETHER, seed, span),
        }
    }

    /// What is left after the first `begun` faults and `passed` of the night.
    pub fn rest(&self, begun: usize, passed: Duration) -> Schedule {
        let later = |entry: &Entry| Entry { at: entry.at.saturating_sub(passed), ..*entry };
        Schedule { entries: self.entries.iter().skip(begun).map(later).collect() }
    }

    /// `count` faults of `kinds` within `span`, the share `together` of them along with their predecessor. Consecutive
    /// seeds go round all kinds evenly.
    pub fn draw(kinds: &[Kind], count: usize, together: f64, seed: u64, span: Duration) -> Schedule {
        let key = Key::new(seed).named("fault plan");
        let first = (seed as usize).wrapping_mul(count);
        let mut picked: Vec<(u64, Kind)> = (0..count)
            .filter_map(|i| Some((key.bits(i as u64), *kinds.get(first.wrapping_add(i) % kinds.len().max(1))?)))
            .collect();
        picked.sort_by_key(|(order, _)| *order);
        let (times, pairs) = (key.named("times"), key.named("pairs"));
        let mut at: Vec<Duration> = (0..count as u64).map(|i| span.mul_f64(0.9 * times.uniform(i))).collect();
        at.sort();
        for i in 1..at.len() {
            if pairs.uniform(i as u64) < together {
                at[i] = at[i - 1];
            }
        }
        let entry = |(i, ((_, kind), at)): (usize, ((u64, Kind), Duration))| Entry {
            at,
            kind,
            draw: key.named("details").with(i as u64),
        };
        Schedule { entries: picked.into_iter().zip(at).enumerate().map(entry).collect() }
    }
}

/// The kinds in an order that puts those of different devices beside each other, the same for every seed.
fn mixed(kinds: Vec<Kind>) -> Vec<Kind> {
    let key = Key::new(0).named("order of kinds");
    let mut ordered: Vec<(u64, Kind)> = kinds.into_iter().enumerate().map(|(i, k)| (key.bits(i as u64), k)).collect();
    ordered.sort();
    ordered.into_iter().map(|(_, kind)| kind).collect()
}

impl FromStr for Mix {
    type Err = String;

    fn from_str(text: &str) -> Result<Mix, String> {
        match text {
            "none" => Ok(Mix::None),
            "typical" => Ok(Mix::Typical),
            "nasty" => Ok(Mix::Nasty),
            other => Err(format!("`{other}` is no mix of faults; none, typical or nasty is allowed")),
        }
    }
}

impl fmt::Display for Mix {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Mix::None => "none",
            Mix::Typical => "typical",
            Mix::Nasty => "nasty",
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeMap;

    const HOUR: Duration = Duration::from_secs(3600);

    #[test]
    fn the_same_seed_gives_the_same_night_and_another_seed_another() {
        let nasty = |seed| Schedule::of(Mix::Nasty, true, seed, HOUR);
        assert_eq!(nasty(7), nasty(7));
        assert_ne!(nasty(7), nasty(8));
        assert!(Schedule::of(Mix::None, true, 7, HOUR).entries.is_empty());
        let entries = nasty(7).entries;
        assert!(entries.is_sorted_by_key(|e| e.at) && entries.iter().all(|e| e.at < HOUR));
    }

    #[test]
    fn every_kind_has_its_share_over_many_nights() {
        for light in [false, true] {
            let mut count: BTreeMap<Kind, usize> = BTreeMap::new();
            for seed in 0..200 {
                for entry in Schedule::of(Mix::Nasty, light, seed, HOUR).entries {
                    *count.entry(entry.kind).or_default() += 1;
                }
            }
            let kinds = Kind::all().len() + if light { Kind::of_the_light().len() } else { 0 };
            assert_eq!(count.len(), kinds);
            assert!(count.values().all(|n| n.abs_diff(200 * NASTY / kinds) <= 1), "{count:?}");
        }
    }

    #[test]
    fn what_is_left_of_a_night_begins_where_it_was_cut() {
        let whole = Schedule::of(Mix::Nasty, false, 7, HOUR);
        let passed = whole.entries[9].at;
        let rest = whole.rest(10, passed).entries;
        assert_eq!(rest.len(), whole.entries.len() - 10);
        assert!(rest.iter().zip(&whole.entries[10..]).all(|(r, w)| r.at == w.at - passed && r.kind == w.kind));
    }
}
