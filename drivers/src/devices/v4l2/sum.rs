//! Exposures beyond the driver's limit: consecutive good frames of equal time, added in 16-bit words.

use crate::frame::Pixels;
use std::time::Duration;

/// A sum under way.
#[derive(Debug, Default)]
pub struct Sum {
    words: Vec<u16>,
    frames: u16,
    start: Duration,
}

// === impl Sum ===

impl Sum {
    /// Throws the sum away: a frame was odd or missing, so the exposures are no longer consecutive.
    pub fn clear(&mut self) {
        self.frames = 0;
    }

    /// Adds a frame that started at `start`. With the `wanted`-th frame the sum is complete: gives the start of its first.
    pub fn add(&mut self, pixels: &Pixels, start: Duration, wanted: u16) -> Option<Duration> {
        if self.frames == 0 {
            self.words.clear();
            self.words.resize(pixels.len(), 0);
            self.start = start;
        }
        match pixels {
            Pixels::U8(v) => self.words.iter_mut().zip(v).for_each(|(s, p)| *s = s.saturating_add(u16::from(*p))),
            Pixels::U16(v) => self.words.iter_mut().zip(v).for_each(|(s, p)| *s = s.saturating_add(*p)),
        }
        self.frames += 1;
        if self.frames < wanted {
            return None;
        }
        self.frames = 0;
        Some(self.start)
    }

    /// The sum, in a used buffer where its kind fits.
    pub fn copy(&self, into: Option<Pixels>) -> Pixels {
        let mut out = if let Some(Pixels::U16(v)) = into { v } else { Vec::new() };
        out.clear();
        out.extend_from_slice(&self.words);
        Pixels::U16(out)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sum_is_of_consecutive_frames_and_starts_with_its_first() {
        let mut sum = Sum::default();
        let at = Duration::from_secs;
        assert_eq!(sum.add(&Pixels::U8(vec![255, 1]), at(1), 2), None);
        assert_eq!(sum.add(&Pixels::U8(vec![255, 2]), at(2), 2), Some(at(1)));
        assert_eq!(sum.copy(None), Pixels::U16(vec![510, 3]));
        assert_eq!(sum.add(&Pixels::U8(vec![9, 9]), at(3), 2), None);
        sum.clear();
        assert_eq!(sum.add(&Pixels::U16(vec![1, 1]), at(4), 2), None);
        assert_eq!(sum.add(&Pixels::U16(vec![4000, 1]), at(5), 2), Some(at(4)));
        assert_eq!(sum.copy(Some(Pixels::U16(vec![7; 9]))), Pixels::U16(vec![4001, 2]));
    }
}
