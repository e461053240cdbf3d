//! Readings of frames that are sums of consecutive exposures of equal time: value / (exposures 2^bits) is the mean NDL of
//! one of them, so the reading is that of one exposure with the variance of a mean.

use super::levels::{Class, Detail, Entry, LevelTable, Reading};

/// A level of a sum; a single exposure is a sum of one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SumLevel {
    /// Digital level: the sum.
    pub level: u16,
    /// Exposures in it, at least 1.
    pub exposures: u16,
}

// === impl SumLevel ===

impl Reading for SumLevel {
    fn entry(self, table: &LevelTable) -> Entry {
        if self.exposures <= 1 { self.level.entry(table) } else { Entry::of(&self.detail(table)) }
    }

    /// How safe it is from the ends of the range is decided by the noise of one exposure: each of them was clipped by
    /// itself.
    fn detail(self, table: &LevelTable) -> Detail {
        if self.exposures <= 1 {
            return self.level.detail(table);
        }
        let radiometer = table.radiometer();
        let (n, levels) = (f64::from(self.exposures), radiometer.levels);
        if self.level == 0 {
            return Detail::clipped(Class::Black, 0.0);
        }
        if u32::from(self.level) >= u32::from(self.exposures) * (levels - 1) {
            return Detail::clipped(Class::Saturated, table.top_x());
        }
        let ndl = radiometer.convention.ndl(0, levels) + f64::from(self.level) / (n * f64::from(levels));
        let one = radiometer.classify(ndl, table.bottom_x(), table.top_x(), true);
        Detail { var: one.var / n, ..one }
    }

    fn floor_x(table: &LevelTable) -> f64 {
        table.bottom_x()
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used)]
    use super::super::levels::tests::{ccd, ingaas};
    use super::*;

    #[test]
    fn a_sum_is_worth_the_mean_of_its_exposures() {
        for radiometer in [ccd(), ingaas()] {
            let table = LevelTable::of(radiometer).unwrap();
            let exposures = 6_u16;
            for level in [radiometer.levels as u16 / 8, radiometer.levels as u16 / 2] {
                let (one, six) =
                    (level.detail(&table), SumLevel { level: level * exposures, exposures }.detail(&table));
                assert!((six.x / one.x - 1.0).abs() < 1e-12 && six.class == one.class);
                assert!((six.var * 6.0 / one.var - 1.0).abs() < 1e-12, "the variance of a mean of six");
                assert_eq!(SumLevel { level, exposures: 1 }.detail(&table), one);
                assert_eq!(SumLevel { level, exposures: 1 }.entry(&table), level.entry(&table));
            }
        }
    }

    #[test]
    fn a_sum_is_saturated_where_all_its_exposures_are_and_usable_nowhere_near_it() {
        let table = LevelTable::of(ccd()).unwrap();
        let class = |level| SumLevel { level, exposures: 257 }.detail(&table).class;
        assert_eq!([class(0), class(128 * 257), class(65_535)], [Class::Black, Class::Good, Class::Saturated]);
        assert_eq!(class(254 * 257), Class::Saturated, "one exposure at 254 may have been clipped");
        assert_eq!(class(257), Class::Low);
    }
}
