//! Equidistant fisheye: pixel <-> viewing direction v at F2, in axes parallel to the camera frame.

use super::direction::Vec3;
use crate::error::EngineError;

/// theta_c = k rho_px, azimuth of v = azimuth of the pixel in the image + roll. Pixel centres at whole numbers, row 0
/// on top.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fisheye {
    /// Column of the principal point.
    pub centre_x_px: f64,
    /// Row of the principal point.
    pub centre_y_px: f64,
    /// k: zenith angle per pixel in degrees.
    pub deg_per_px: f64,
    /// Rotation of the camera about its axis in degrees.
    pub roll_deg: f64,
}

/// A fisheye with its angles worked out.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Lens {
    fisheye: Fisheye,
    k: f64,
    sin_roll: f64,
    cos_roll: f64,
}

// === impl Fisheye ===

impl Fisheye {
    /// Viewing direction at image point (`column`, `row`), whole numbers at pixel centres. z < 0 beyond the
    /// hemisphere.
    pub fn view(&self, column: f64, row: f64) -> Vec3 {
        Lens::of(*self).view(column, row).0
    }

    /// Image point (column, row) of a viewing direction; the length of `v` does not matter.
    pub fn pixel(&self, v: Vec3) -> (f64, f64) {
        let theta = v.x.hypot(v.y).atan2(v.z);
        let rho = theta / self.deg_per_px.to_radians();
        let azimuth = v.y.atan2(v.x) - self.roll_deg.to_radians();
        (self.centre_x_px + rho * azimuth.cos(), self.centre_y_px - rho * azimuth.sin())
    }

    /// Zenith angle theta_c in degrees of an image point.
    pub fn zenith_deg(&self, column: f64, row: f64) -> f64 {
        (column - self.centre_x_px).hypot(row - self.centre_y_px) * self.deg_per_px
    }

    /// Radius of the hemisphere in pixels.
    pub fn radius_px(&self) -> f64 {
        90.0 / self.deg_per_px
    }

    pub(crate) fn check(&self) -> Result<(), EngineError> {
        if self.deg_per_px > 0.0 && self.deg_per_px.is_finite() {
            return Ok(());
        }
        Err(EngineError::Parameter { name: "deg_per_px", value: self.deg_per_px, allowed: "it must be positive" })
    }
}

// === impl Lens ===

impl Lens {
    pub(crate) fn of(fisheye: Fisheye) -> Lens {
        let (sin_roll, cos_roll) = fisheye.roll_deg.to_radians().sin_cos();
        Lens { fisheye, k: fisheye.deg_per_px.to_radians(), sin_roll, cos_roll }
    }

    /// k in radians per pixel.
    pub(crate) fn k(&self) -> f64 {
        self.k
    }

    /// Viewing direction and solid angle per pixel area, dO_px = k^2 sin(theta_c) / theta_c (physics 5.3).
    pub(crate) fn view(&self, column: f64, row: f64) -> (Vec3, f64) {
        let x = column - self.fisheye.centre_x_px;
        let y = self.fisheye.centre_y_px - row;
        let theta = x.hypot(y) * self.k;
        let (s, c) = theta.sin_cos();
        let sinc = if theta > 1e-9 { s / theta } else { 1.0 };
        let scale = sinc * self.k;
        let v = Vec3 {
            x: scale * (x * self.cos_roll - y * self.sin_roll),
            y: scale * (x * self.sin_roll + y * self.cos_roll),
            z: c,
        };
        (v, self.k * self.k * sinc)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CCD: Fisheye = Fisheye { centre_x_px: 695.5, centre_y_px: 527.5, deg_per_px: 0.1886, roll_deg: 3.7 };

    #[test]
    fn pixels_survive_the_way_through_their_direction() {
        for (c, r) in [(695.5, 527.5), (700.0, 100.0), (250.25, 700.75), (1100.0, 527.5)] {
            let (c2, r2) = CCD.pixel(CCD.view(c, r));
            assert!((c - c2).abs() < 1e-10 && (r - r2).abs() < 1e-10);
        }
    }

    #[test]
    fn the_hemisphere_is_477_pixels_wide_and_up_is_up() {
        assert!((CCD.radius_px() - 477.2).abs() < 0.01);
        let level = Fisheye { roll_deg: 0.0, ..CCD };
        let up = level.view(695.5, 527.5 - 100.0);
        assert!(up.y > 0.0 && up.x.abs() < 1e-12);
        assert!((up.y - 18.86_f64.to_radians().sin()).abs() < 1e-12);
        let rolled = Fisheye { roll_deg: 90.0, ..CCD }.view(795.5, 527.5);
        assert!(rolled.y > 0.0 && rolled.x.abs() < 1e-12, "azimuth of v = azimuth in the image + roll");
    }
}
