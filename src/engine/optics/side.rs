//! The four hemisphere pairs of a sample and the frames they are told in.
//!
//! Sample frame: z towards the interior, y up, x right as seen from the interior. "Front" is the exterior, as in
//! the Klems file. Camera frame: z towards the camera. The holder shows the camera either the interior side
//! (the frames coincide) or, turned about the vertical, the exterior side: (x, y, z) -> (-x, y, -z).

use super::direction::{Direction, Vec3};
use serde::{Deserialize, Serialize};

/// A hemisphere pair: where light comes from and where it leaves to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Side {
    /// Light from the exterior, leaving to the interior.
    TransmissionFront,
    /// Light from the exterior, leaving to the exterior.
    ReflectionFront,
    /// Light from the interior, leaving to the exterior.
    TransmissionBack,
    /// Light from the interior, leaving to the interior.
    ReflectionBack,
}

// === impl Side ===

impl Side {
    /// All four, in the order of the Klems file.
    pub const ALL: [Side; 4] =
        [Side::TransmissionFront, Side::ReflectionFront, Side::TransmissionBack, Side::ReflectionBack];

    /// True where light leaves on the side opposite to where it came from.
    pub fn is_transmission(self) -> bool {
        matches!(self, Side::TransmissionFront | Side::TransmissionBack)
    }

    /// True where light comes from the exterior.
    pub fn from_exterior(self) -> bool {
        matches!(self, Side::TransmissionFront | Side::ReflectionFront)
    }

    /// True where the camera must see the exterior side, so the sample is turned about the vertical.
    pub fn flipped(self) -> bool {
        matches!(self, Side::ReflectionFront | Side::TransmissionBack)
    }

    /// Vector from the sample to the source in the sample frame, for an incident direction told as `theta` from the
    /// normal on the source's side and `phi`, azimuth of the source about z, x towards y.
    pub fn source_vector(self, incident: Direction) -> Vec3 {
        let v = incident.vector();
        Vec3 { z: if self.from_exterior() { -v.z } else { v.z }, ..v }
    }

    /// The same vector in the camera frame.
    pub fn source_in_camera_frame(self, incident: Direction) -> Vec3 {
        self.to_other_frame(self.source_vector(incident))
    }

    /// Camera frame to sample frame or back (the turn is its own inverse).
    pub fn to_other_frame(self, v: Vec3) -> Vec3 {
        if self.flipped() { Vec3 { x: -v.x, y: v.y, z: -v.z } } else { v }
    }

    /// Emergent direction in file coordinates (theta from the normal on the emergent side, azimuth about the sample's
    /// z) of a direction `u` in the camera frame.
    pub fn emergent(self, u_camera: Vec3) -> Direction {
        let v = self.to_other_frame(u_camera);
        Vec3 { z: v.z.abs(), ..v }.direction()
    }

    /// The Klems file names an incident patch by the azimuth in which light travels: source azimuth + 180 degrees.
    pub fn file_incident(incident: Direction) -> Direction {
        let (theta, phi) = incident.degrees();
        Direction::from_degrees(theta, phi + 180.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Straight-through transmission and mirror reflection lie on the diagonal of the file's matrix.
    #[test]
    fn straight_through_and_mirror_are_diagonal() {
        let incident = Direction::from_degrees(40.0, 250.0);
        let file = Side::file_incident(incident);
        for side in Side::ALL {
            let s = side.source_in_camera_frame(incident);
            let leaving = if side.is_transmission() {
                Vec3 { x: -s.x, y: -s.y, z: -s.z }
            } else {
                Vec3 { x: -s.x, y: -s.y, z: s.z }
            };
            assert!(leaving.z > 0.0, "{side:?}: the camera must see it");
            let out = side.emergent(leaving);
            assert!((out.theta - file.theta).abs() < 1e-12 && (out.phi - file.phi).abs() < 1e-12, "{side:?}");
        }
    }
}
