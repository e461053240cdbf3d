//! From a spectrometer's pixels and raw counts to wavelengths and linear counts.
//!
//! Source: OEM data sheets: wavelength and non-linearity polynomials, black pixels, saturation level.

use super::oceanoptics_protocol::Model;
use crate::contract::Spectrum;
use crate::units::ExposureTime;
use tokio::time::Instant;

/// A wavelength scale between these is believed.
const SCALE_NM: std::ops::Range<f64> = 100.0..3000.0;
/// A non-linearity of this size at any count is believed.
const LINEARITY: std::ops::Range<f64> = 0.5..2.0;
/// Counts at which the non-linearity is looked at.
const LOOKS: u32 = 64;

/// What the device's memory says.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct Scale {
    wavelength_nm: Vec<f64>,
    linearity: Vec<f64>,
    saturation: u16,
}

// === impl Scale ===

impl Scale {
    /// The scale of a model with these wavelength and non-linearity coefficients, lowest power first, and the raw count
    /// of a saturated pixel.
    ///
    /// # Errors
    /// What the coefficients would give, where no spectrometer is like that.
    pub(super) fn new(
        model: &Model,
        wavelength: &[f64],
        linearity: Vec<f64>,
        saturation: u16,
    ) -> Result<Scale, String> {
        let pixels = model.active.start..model.active.end;
        let wavelength_nm: Vec<f64> = pixels.map(|pixel| polynomial(wavelength, pixel as f64)).collect();
        let ascending = wavelength_nm.windows(2).all(|pair| matches!(pair, [a, b] if a < b));
        let (first, last) = (wavelength_nm.first(), wavelength_nm.last());
        if !ascending || !first.into_iter().chain(last).all(|nm| SCALE_NM.contains(nm)) {
            return Err(format!(
                "the wavelength coefficients give {first:?} to {last:?} nm, not ascending wavelengths from 100 to 3000 nm; the device's calibration is lost"
            ));
        }
        let counts = (0..=LOOKS).map(|i| f64::from(model.full) * f64::from(i) / f64::from(LOOKS));
        for count in counts {
            let factor = polynomial(&linearity, count);
            if !LINEARITY.contains(&factor) {
                return Err(format!(
                    "the non-linearity polynomial gives {factor} at {count} counts, a value near 1 is needed; the device's calibration is lost"
                ));
            }
        }
        Ok(Scale { wavelength_nm, linearity, saturation })
    }

    /// Counts less dark, scaled to the full range and made linear, for the pixels that see light.
    pub(super) fn spectrum(&self, model: &Model, raw: &[u16], exposure: ExposureTime, at: Instant) -> Spectrum {
        let dark = model.dark.of(raw);
        let level = dark.iter().map(|&c| f64::from(c)).sum::<f64>() / dark.len().max(1) as f64;
        let factor = f64::from(model.full) / f64::from(self.saturation.max(1));
        let active = model.active.of(raw);
        let linear = |&count: &u16| {
            let value = (f64::from(count) - level) * factor;
            value / polynomial(&self.linearity, value)
        };
        Spectrum {
            wavelength_nm: self.wavelength_nm.clone(),
            counts: active.iter().map(linear).collect(),
            exposure,
            saturated: active.iter().filter(|&&count| count >= self.saturation).count(),
            at,
        }
    }
}

/// c0 + c1 x + c2 x^2 + ...
fn polynomial(coefficients: &[f64], x: f64) -> f64 {
    coefficients.iter().rev().fold(0.0, |sum, c| sum * x + c)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used)]
    use super::super::oceanoptics_protocol::MODELS;
    use super::*;

    #[test]
    fn counts_are_dark_free_linear_and_on_the_pixels_that_see_light() {
        let scale = Scale::new(&MODELS[0], &[350.0, 0.35], vec![1.0, -1e-5], 4095).unwrap();
        let mut raw = vec![100_u16; 2048];
        (raw[26], raw[2047]) = (1100, 4095);
        let spectrum = scale.spectrum(&MODELS[0], &raw, ExposureTime(3000), Instant::now());
        assert_eq!(spectrum.counts.len(), 2022);
        assert!((spectrum.counts[0] - 1000.0 / 0.99).abs() < 1e-9);
        assert_eq!((spectrum.wavelength_nm[0], spectrum.saturated), (350.0 + 0.35 * 26.0, 1));
    }

    #[test]
    fn a_lost_calibration_is_no_scale() {
        for (wavelength, linearity) in [
            ([0.0, 0.35], vec![1.0]),
            ([900.0, -0.1], vec![1.0]),
            ([350.0, 0.35], vec![0.0]),
            ([350.0, 0.35], vec![1.0, 1e-2]),
        ] {
            let why = Scale::new(&MODELS[0], &wavelength, linearity, 4095).unwrap_err();
            assert!(why.contains("calibration is lost"), "{why}");
        }
    }
}
