//! Small vectors, and the frames of camera and sample.
//!
//! Camera frame: z towards the camera, y up, x along the line of foci. Sample frame: z towards the interior, y up,
//! x right as seen from the interior. The changer shows the camera either the interior (frames coincide) or, turned
//! about y, the exterior.

use serde::{Deserialize, Serialize};
use std::ops::{Add, Mul, Neg, Sub};

/// A vector in three dimensions.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct V3 {
    /// First component.
    pub x: f64,
    /// Second component.
    pub y: f64,
    /// Third component.
    pub z: f64,
}

/// A hemisphere pair of the sample, in the words of the Klems file (front = exterior).
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub enum Side {
    /// Exterior to interior.
    #[serde(rename = "tf")]
    TransmissionFront,
    /// Exterior to exterior.
    #[serde(rename = "rf")]
    ReflectionFront,
    /// Interior to exterior.
    #[serde(rename = "tb")]
    TransmissionBack,
    /// Interior to interior.
    #[serde(rename = "rb")]
    ReflectionBack,
}

// === impl V3 ===

impl V3 {
    /// A vector of its components.
    pub const fn new(x: f64, y: f64, z: f64) -> V3 {
        V3 { x, y, z }
    }

    /// The unit vector at polar angle `theta` from +z and azimuth `phi` (radians).
    pub fn polar(theta: f64, phi: f64) -> V3 {
        let (st, ct) = theta.sin_cos();
        let (sp, cp) = phi.sin_cos();
        V3::new(st * cp, st * sp, ct)
    }

    /// Scalar product.
    pub fn dot(self, o: V3) -> f64 {
        self.x * o.x + self.y * o.y + self.z * o.z
    }

    /// Vector product.
    pub fn cross(self, o: V3) -> V3 {
        V3::new(self.y * o.z - self.z * o.y, self.z * o.x - self.x * o.z, self.x * o.y - self.y * o.x)
    }

    /// Length.
    pub fn norm(self) -> f64 {
        self.dot(self).sqrt()
    }

    /// The same direction with length one; the zero vector stays.
    pub fn unit(self) -> V3 {
        let n = self.norm();
        if n > 0.0 { self * (1.0 / n) } else { self }
    }

    /// Turned about x, then about y, by angles told as (sine, cosine).
    pub fn tilted(self, (sx, cx): (f64, f64), (sy, cy): (f64, f64)) -> V3 {
        let r = V3::new(self.x, cx * self.y - sx * self.z, sx * self.y + cx * self.z);
        V3::new(cy * r.x + sy * r.z, r.y, -sy * r.x + cy * r.z)
    }

    /// Camera frame to the frame of a sample turned about y, or back.
    pub fn turned(self) -> V3 {
        V3::new(-self.x, self.y, -self.z)
    }
}

impl Add for V3 {
    type Output = V3;
    fn add(self, o: V3) -> V3 {
        V3::new(self.x + o.x, self.y + o.y, self.z + o.z)
    }
}

impl Sub for V3 {
    type Output = V3;
    fn sub(self, o: V3) -> V3 {
        V3::new(self.x - o.x, self.y - o.y, self.z - o.z)
    }
}

impl Mul<f64> for V3 {
    type Output = V3;
    fn mul(self, k: f64) -> V3 {
        V3::new(self.x * k, self.y * k, self.z * k)
    }
}

impl Neg for V3 {
    type Output = V3;
    fn neg(self) -> V3 {
        self * -1.0
    }
}

// === impl Side ===

impl Side {
    /// All four.
    pub const ALL: [Side; 4] =
        [Side::TransmissionFront, Side::ReflectionFront, Side::TransmissionBack, Side::ReflectionBack];

    /// The pair of hemispheres of a vector to the source and an emergent vector, both in the sample frame.
    pub fn of(source: V3, emergent: V3) -> Side {
        match (source.z < 0.0, emergent.z >= 0.0) {
            (true, true) => Side::TransmissionFront,
            (true, false) => Side::ReflectionFront,
            (false, false) => Side::TransmissionBack,
            (false, true) => Side::ReflectionBack,
        }
    }

    /// Light leaves on the other side.
    pub fn is_transmission(self) -> bool {
        matches!(self, Side::TransmissionFront | Side::TransmissionBack)
    }

    /// Sign of z on the side the light comes from.
    pub fn source_sign(self) -> f64 {
        if matches!(self, Side::TransmissionFront | Side::ReflectionFront) { -1.0 } else { 1.0 }
    }

    /// Sign of z on the side the light leaves to.
    pub fn emergent_sign(self) -> f64 {
        if self.is_transmission() { -self.source_sign() } else { self.source_sign() }
    }

    /// Vector to the source in the sample frame; `theta_deg` from the normal on the source's side, `phi_deg` azimuth
    /// of the source from x towards y.
    pub fn source_vector(self, theta_deg: f64, phi_deg: f64) -> V3 {
        let v = V3::polar(theta_deg.to_radians(), phi_deg.to_radians());
        V3::new(v.x, v.y, self.source_sign() * v.z)
    }

    /// The same pair read backwards: light comes from where it left to.
    pub fn reversed(self) -> Side {
        match self {
            Side::TransmissionFront => Side::TransmissionBack,
            Side::TransmissionBack => Side::TransmissionFront,
            other => other,
        }
    }
}

/// Vector to the source in the camera frame for holder angles told without zero offsets (degrees):
/// s = (sin T cos P, sin T sin P, cos T).
pub fn source_in_camera_frame(tilt_deg: f64, spin_deg: f64) -> V3 {
    V3::polar(tilt_deg.to_radians(), spin_deg.to_radians())
}
