//! Directions and unit vectors.

use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;

/// A direction in polar coordinates: `theta` from +z, `phi` from x to y, both in radians.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Direction {
    /// Polar angle from +z, 0 to pi.
    pub theta: f64,
    /// Azimuth from x towards y, 0 to 2 pi.
    pub phi: f64,
}

/// A vector in right-handed coordinates.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Vec3 {
    /// x
    pub x: f64,
    /// y
    pub y: f64,
    /// z
    pub z: f64,
}

// === impl Direction ===

impl Direction {
    /// A direction from angles in degrees; phi is wrapped into 0 to 360.
    pub fn from_degrees(theta: f64, phi: f64) -> Direction {
        Direction { theta: theta.to_radians(), phi: phi.rem_euclid(360.0).to_radians() }
    }

    /// Polar angle and azimuth in degrees.
    pub fn degrees(self) -> (f64, f64) {
        (self.theta.to_degrees(), self.phi.to_degrees())
    }

    /// The unit vector.
    pub fn vector(self) -> Vec3 {
        let (st, ct) = self.theta.sin_cos();
        let (sp, cp) = self.phi.sin_cos();
        Vec3 { x: st * cp, y: st * sp, z: ct }
    }
}

// === impl Vec3 ===

impl Vec3 {
    /// The direction of the vector; its length does not matter.
    pub fn direction(self) -> Direction {
        let theta = self.x.hypot(self.y).atan2(self.z);
        Direction { theta, phi: self.y.atan2(self.x).rem_euclid(TAU) }
    }

    /// Scalar product.
    pub fn dot(self, other: Vec3) -> f64 {
        self.x * other.x + self.y * other.y + self.z * other.z
    }

    /// Angle to another vector, in radians; accurate for small angles.
    pub fn angle_to(self, other: Vec3) -> f64 {
        let cross = Vec3 {
            x: self.y * other.z - self.z * other.y,
            y: self.z * other.x - self.x * other.z,
            z: self.x * other.y - self.y * other.x,
        };
        cross.dot(cross).sqrt().atan2(self.dot(other))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_direction_survives_the_way_through_its_vector() {
        let d = Direction::from_degrees(37.0, 301.0);
        let back = d.vector().direction();
        assert!((back.theta - d.theta).abs() < 1e-14 && (back.phi - d.phi).abs() < 1e-14);
    }
}
