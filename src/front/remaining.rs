//! How long a run under way will still take, and when it is done.

use goniod_drivers::clock::UtcMicros;

/// Seconds left after `elapsed_s`, when `done` of `to_do` exposures are done and all were forecast to take
/// `forecast_s`: the forecast rules at first, what was seen later.
pub fn left_s(forecast_s: f64, elapsed_s: f64, done: u32, to_do: u32) -> f64 {
    let share = f64::from(done) / f64::from(to_do.max(1));
    let seen_s = if share > 0.0 { elapsed_s / share } else { forecast_s };
    let total_s = (1.0 - share) * forecast_s.max(elapsed_s) + share * seen_s;
    (total_s - elapsed_s).max(0.0)
}

/// The moment `seconds` after another one; one that cannot be told is the last there is.
pub fn after(start: UtcMicros, seconds: f64) -> UtcMicros {
    // The cast keeps to the whole numbers there are, too.
    UtcMicros(start.0.saturating_add((seconds * 1e6) as i64))
}

#[cfg(test)]
mod tests {
    use super::{after, left_s};
    use crate::front::night::stamp;
    use goniod_drivers::clock::UtcMicros;

    #[test]
    fn the_forecast_rules_at_first_and_what_was_seen_later() {
        assert_eq!(left_s(100.0, 0.0, 0, 10), 100.0);
        assert_eq!(left_s(100.0, 200.0, 10, 10), 0.0);
        assert_eq!(left_s(100.0, 100.0, 5, 10), 50.0, "twice as slow as forecast: half of the rest is seen");
        assert!(left_s(100.0, 500.0, 0, 0) >= 0.0, "nothing to do takes no negative time");
    }

    #[test]
    fn an_end_beyond_all_calendars_is_their_last_moment() {
        assert_eq!(after(UtcMicros(5), 1.5), UtcMicros(1_500_005));
        assert_eq!(after(UtcMicros(5), 1e300), UtcMicros(i64::MAX));
        assert!(stamp(after(UtcMicros(5), 1e300)).to_string().starts_with("9999-12-"));
    }
}
