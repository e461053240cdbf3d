//! Colours: a perceptually even map for the BSDF, its logarithmic scale, and the colours of the four sides.

use crate::engine::optics::side::Side;
use plotters::style::RGBColor;

/// Text and axes.
pub const INK: RGBColor = RGBColor(33, 37, 41);
/// Second-rank text.
pub const GREY: RGBColor = RGBColor(108, 117, 125);
/// Grid lines.
pub const FAINT: RGBColor = RGBColor(225, 228, 232);
/// Ground of a patch that was not measured.
pub const ABSENT: RGBColor = RGBColor(222, 222, 222);
/// Hatch of a patch that was not measured.
pub const HATCH: RGBColor = RGBColor(178, 178, 178);

/// Ten anchors of the map "viridis" (S. van der Walt and N. Smith, matplotlib 1.5, CC0).
const VIRIDIS: [[f64; 3]; 10] = [
    [68.0, 1.0, 84.0],
    [72.0, 40.0, 120.0],
    [62.0, 74.0, 137.0],
    [49.0, 104.0, 142.0],
    [38.0, 130.0, 142.0],
    [31.0, 158.0, 137.0],
    [53.0, 183.0, 121.0],
    [110.0, 206.0, 88.0],
    [181.0, 222.0, 43.0],
    [253.0, 231.0, 37.0],
];

/// Largest ratio of top to bottom of a scale.
const SPAN: f64 = 1e4;

/// A logarithmic colour scale.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LogScale {
    /// Value of the darkest colour; everything below is drawn so.
    pub bottom: f64,
    /// Value of the brightest colour.
    pub top: f64,
}

// === impl LogScale ===

impl LogScale {
    /// The scale for some values: up to the largest, down to the smallest positive one, at most four decades. `None`
    /// where no value is positive.
    pub fn of(values: impl Iterator<Item = f64>) -> Option<LogScale> {
        let (mut low, mut top) = (f64::INFINITY, 0.0_f64);
        for v in values.filter(|v| v.is_finite() && *v > 0.0) {
            low = low.min(v);
            top = top.max(v);
        }
        // At least half a decade, so that an even diffuser is not drawn as noise.
        (top > 0.0).then(|| LogScale { bottom: low.clamp(top / SPAN, top / 3.2), top: top * 1.0001 })
    }

    /// Place of a value on the scale, 0 to 1.
    pub fn place(&self, value: f64) -> f64 {
        if value <= self.bottom {
            return 0.0;
        }
        ((value / self.bottom).ln() / (self.top / self.bottom).ln()).min(1.0)
    }

    /// Colour of a value.
    pub fn colour(&self, value: f64) -> RGBColor {
        viridis(self.place(value))
    }

    /// Values to label: 1, 2, 5 below 1.7 decades, else powers of ten.
    pub fn ticks(&self) -> Vec<f64> {
        let decades = (self.top / self.bottom).log10();
        let steps: &[f64] = if decades < 1.7 { &[1.0, 2.0, 5.0] } else { &[1.0] };
        let (first, last) = (self.bottom.log10().floor() as i32, self.top.log10().ceil() as i32);
        (first..=last)
            .flat_map(|e| steps.iter().map(move |s| s * 10f64.powi(e)))
            .filter(|v| *v >= self.bottom * 0.999 && *v <= self.top * 1.001)
            .collect()
    }
}

/// A colour of the map, `t` from 0 to 1.
pub fn viridis(t: f64) -> RGBColor {
    let x = t.clamp(0.0, 1.0) * (VIRIDIS.len() - 1) as f64;
    let i = (x.floor() as usize).min(VIRIDIS.len() - 2);
    let (a, b) = (VIRIDIS[i], VIRIDIS[i + 1]);
    let mix = |c: usize| (a[c] + (b[c] - a[c]) * (x - i as f64)).round() as u8;
    RGBColor(mix(0), mix(1), mix(2))
}

/// Colour of a side, told apart with the common colour-vision deficiencies (palette of M. Okabe and K. Ito).
pub fn side_colour(side: Side) -> RGBColor {
    match side {
        Side::TransmissionFront => RGBColor(0, 114, 178),
        Side::ReflectionFront => RGBColor(213, 94, 0),
        Side::TransmissionBack => RGBColor(0, 158, 115),
        Side::ReflectionBack => RGBColor(204, 121, 167),
    }
}

/// A number as a label: plain between 0.001 and 10 000, else with an exponent.
pub fn label(value: f64) -> String {
    if (1e-3 * 0.999..1e4).contains(&value) {
        format!("{}", (value * 1e6).round() / 1e6)
    } else {
        format!("{value:.0e}")
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn a_scale_spans_its_values_and_at_most_four_decades() {
        let scale = LogScale::of([f64::NAN, -1.0, 0.0, 1e-9, 0.05, 21.0].into_iter()).unwrap();
        assert!((scale.bottom - 21.0e-4).abs() < 1e-9);
        assert_eq!(scale.colour(1e-9), viridis(0.0));
        assert_eq!(scale.colour(30.0), viridis(1.0));
        assert_eq!(scale.ticks().into_iter().map(label).collect::<Vec<_>>(), ["0.01", "0.1", "1", "10"]);
        assert!(LogScale::of([0.0, f64::NAN].into_iter()).is_none());
    }

    #[test]
    fn an_even_diffuser_has_one_colour_and_readable_ticks() {
        let scale = LogScale::of([0.0636, 0.0637].into_iter()).unwrap();
        assert!((scale.place(0.0637) - scale.place(0.0636)).abs() < 0.01);
        assert_eq!(scale.ticks().into_iter().map(label).collect::<Vec<_>>(), ["0.02", "0.05"]);
    }
}
