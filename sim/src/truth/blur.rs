//! Point spread of lens and optical low-pass filter: what falls on one pixel falls on its neighbours too. Without it a
//! peak as small as the colour mosaic would be seen by some colours and missed by others.

use rayon::prelude::*;

/// A Gaussian point spread, separable.
#[derive(Debug, Clone, PartialEq)]
pub struct Blur {
    taps: Vec<f32>,
}

// === impl Blur ===

impl Blur {
    /// Standard deviation in pixels; 0 = none.
    pub fn new(sigma_px: f64) -> Blur {
        if sigma_px <= 0.0 {
            return Blur { taps: vec![1.0] };
        }
        let radius = (3.5 * sigma_px).ceil() as i32;
        let weights: Vec<f64> = (-radius..=radius).map(|i| (-0.5 * (f64::from(i) / sigma_px).powi(2)).exp()).collect();
        let sum: f64 = weights.iter().sum();
        Blur { taps: weights.iter().map(|w| (w / sum) as f32).collect() }
    }

    /// True where nothing is spread.
    pub fn is_none(&self) -> bool {
        self.taps.len() == 1
    }

    /// Reach in pixels.
    pub fn radius(&self) -> usize {
        self.taps.len() / 2
    }

    /// Spreads a picture of `width` columns; beyond its edge it counts as dark.
    pub fn spread(&self, values: &[f32], width: usize) -> Vec<f32> {
        if self.is_none() || width == 0 {
            return values.to_vec();
        }
        let mut along = vec![0.0f32; values.len()];
        along.par_chunks_mut(width).zip(values.par_chunks(width)).for_each(|(out, row)| self.line(out, row));
        let (radius, height) = (self.radius(), values.len() / width);
        let mut out = vec![0.0f32; values.len()];
        out.par_chunks_mut(width).enumerate().for_each(|(row, out)| {
            for (k, tap) in self.taps.iter().enumerate() {
                let Some(from) = (row + k).checked_sub(radius).filter(|r| *r < height) else { continue };
                for (o, v) in out.iter_mut().zip(&along[from * width..(from + 1) * width]) {
                    *o += tap * v;
                }
            }
        });
        out
    }

    fn line(&self, out: &mut [f32], row: &[f32]) {
        let radius = self.radius();
        for (k, tap) in self.taps.iter().enumerate() {
            let shift = k as isize - radius as isize;
            let (first, from) = if shift < 0 { ((-shift) as usize, 0) } else { (0, shift as usize) };
            for (o, v) in out.iter_mut().skip(first).zip(row.iter().skip(from)) {
                *o += tap * v;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_point_spreads_and_nothing_is_lost() {
        let mut picture = vec![0.0f32; 31 * 31];
        picture[15 * 31 + 15] = 1.0;
        let spread = Blur::new(1.2).spread(&picture, 31);
        let sum: f32 = spread.iter().sum();
        assert!((sum - 1.0).abs() < 1e-5, "{sum}");
        let second: f32 = (0..31 * 31).map(|i| spread[i] * ((i % 31) as f32 - 15.0).powi(2)).sum();
        assert!((second.sqrt() - 1.2).abs() < 0.02, "{}", second.sqrt());
        assert_eq!(Blur::new(0.0).spread(&picture, 31), picture);
    }
}
