//! Which axis angles show a side of the sample, or a reference, under an incident direction.

use super::incidence::Incident;
use super::instrument::{Axis, Instrument};
use crate::engine::optics::side::Side;
use std::fmt;

/// Axis angles are commanded in whole millionths of a degree, so that a plan's text says exactly what is driven.
const STEPS_PER_DEG: f64 = 1e6;

/// Angles of the holder's axes, as commanded (zero angle included).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pose {
    /// Tilt.
    pub tilt_deg: f64,
    /// Spin.
    pub spin_deg: f64,
    /// Changer, where there is one.
    pub changer_deg: Option<f64>,
}

/// Why a pose cannot be had.
#[derive(Debug, Clone, PartialEq)]
pub enum Unreachable {
    /// An axis would have to go beyond its limits.
    Limit {
        /// Axis by its key in the instrument file, `tilt`, `spin` or `changer`.
        axis: &'static str,
        /// The angle it would need.
        needed_deg: f64,
        /// Its limits.
        limits_deg: (f64, f64),
    },
    /// The exterior side must face the camera, and nothing turns the sample over.
    NoChanger,
    /// A reference is to be shown, and the changer has no place for it.
    NoReference,
}

// === impl Pose ===

impl Pose {
    /// The pose for a side of the sample. Camera frame: the vector to the source has polar angle T (tilt) and azimuth
    /// P (spin); T = theta in reflection and 180 - theta in transmission; P = phi, or 180 - phi where the sample is
    /// turned over about the vertical. On the pole P means nothing to the light and follows the same rule, so that a
    /// plane of incidence is driven without spinning.
    ///
    /// # Errors
    /// An axis limit, or no changer for a side that needs one.
    pub fn of_sample(instrument: &Instrument, side: Side, incident: Incident) -> Result<Pose, Unreachable> {
        let tilt = if side.is_transmission() { 180.0 - incident.theta_deg } else { incident.theta_deg };
        let spin = if side.flipped() { 180.0 - incident.phi_deg } else { incident.phi_deg };
        let changer = match (&instrument.holder.changer, side.flipped()) {
            (Some(c), true) => Some(c.sample_flipped_deg),
            (Some(c), false) => Some(c.sample_deg),
            (None, false) => None,
            (None, true) => return Err(Unreachable::NoChanger),
        };
        Pose::within(instrument, tilt, spin, changer)
    }

    /// The pose for the transmitting or reflecting diffuser, lit under `theta_deg` at spin 0.
    ///
    /// # Errors
    /// An axis limit, or no changer or no place on it for the diffuser.
    pub fn of_reference(instrument: &Instrument, transmission: bool, theta_deg: f64) -> Result<Pose, Unreachable> {
        let changer = instrument.holder.changer.as_ref().ok_or(Unreachable::NoReference)?;
        let place = if transmission { changer.transmission_reference_deg } else { changer.reflection_reference_deg };
        let tilt = if transmission { 180.0 - theta_deg } else { theta_deg };
        Pose::within(instrument, tilt, 0.0, Some(place.ok_or(Unreachable::NoReference)?))
    }

    fn within(instrument: &Instrument, tilt: f64, spin: f64, changer: Option<f64>) -> Result<Pose, Unreachable> {
        let holder = &instrument.holder;
        let tilt_deg = reach("tilt", &holder.tilt, &[tilt])?;
        let spin = spin.rem_euclid(360.0);
        let spin_deg = reach("spin", &holder.spin, &[spin, spin - 360.0, spin + 360.0])?;
        let changer_deg = match (changer, &holder.changer) {
            (Some(angle), Some(c)) => Some(reach("changer", &c.axis, &[angle])?),
            _ => None,
        };
        Ok(Pose { tilt_deg, spin_deg, changer_deg })
    }
}

/// The first of equivalent angles that the axis may be commanded to.
fn reach(name: &'static str, axis: &Axis, angles: &[f64]) -> Result<f64, Unreachable> {
    let commanded = |angle: &f64| ((axis.zero_deg + angle) * STEPS_PER_DEG).round() / STEPS_PER_DEG;
    let allowed = |a: &f64| *a >= axis.min_deg && *a <= axis.max_deg;
    angles.iter().map(commanded).find(allowed).ok_or_else(|| Unreachable::Limit {
        axis: name,
        needed_deg: angles.first().map_or(f64::NAN, commanded),
        limits_deg: (axis.min_deg, axis.max_deg),
    })
}

// === impl Unreachable ===

impl fmt::Display for Unreachable {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Unreachable::Limit { axis, needed_deg, limits_deg: (min, max) } => {
                write!(f, "the {axis} axis would have to go to {needed_deg} degrees, but may go from {min} to {max}")
            }
            Unreachable::NoChanger => f.write_str(
                "the exterior side must face the camera, and the holder has no changer that turns the sample over",
            ),
            Unreachable::NoReference => f.write_str("the holder has no changer place for this diffuser"),
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::config::testing::instrument;
    use crate::engine::optics::direction::Vec3;

    /// The axis angles, read as a vector, are the source in the camera frame of the engine's rules.
    #[test]
    fn poses_are_the_source_in_the_camera_frame() {
        let mut i = instrument();
        i.holder.tilt.zero_deg = 0.5;
        for side in Side::ALL {
            for (theta, phi) in [(0.0, 180.0), (10.0, 45.0), (82.5, 330.0), (40.0, 200.0)] {
                let incident = Incident::new(theta, phi);
                let pose = Pose::of_sample(&i, side, incident).unwrap();
                let (t, p) = ((pose.tilt_deg - 0.5).to_radians(), pose.spin_deg.to_radians());
                let s = Vec3 { x: t.sin() * p.cos(), y: t.sin() * p.sin(), z: t.cos() };
                let want = side.source_in_camera_frame(incident.direction());
                assert!(s.angle_to(want) < 1e-7, "{side:?} {theta} {phi}");
                let turned = if side.flipped() { 180.0 } else { 0.0 };
                assert_eq!(pose.changer_deg, Some(turned));
            }
        }
    }

    #[test]
    fn limits_and_missing_axes_are_told() {
        let mut i = instrument();
        i.holder.spin.max_deg = 200.0;
        i.holder.spin.min_deg = -170.0;
        let pose = Pose::of_sample(&i, Side::TransmissionFront, Incident::new(20.0, 345.0)).unwrap();
        assert_eq!(pose.spin_deg, -15.0, "a turn less is the same azimuth");
        i.holder.tilt.max_deg = 150.0;
        let e = Pose::of_sample(&i, Side::TransmissionFront, Incident::new(20.0, 0.0)).unwrap_err();
        assert_eq!(e, Unreachable::Limit { axis: "tilt", needed_deg: 160.0, limits_deg: (-2.0, 150.0) });
        assert_eq!(Pose::of_reference(&i, false, 8.0).unwrap().changer_deg, Some(90.0));
        i.holder.changer = None;
        assert_eq!(Pose::of_sample(&i, Side::ReflectionFront, Incident::new(0.0, 0.0)), Err(Unreachable::NoChanger));
        assert!(Pose::of_sample(&i, Side::ReflectionBack, Incident::new(0.0, 0.0)).is_ok());
        assert_eq!(Pose::of_reference(&i, true, 0.0), Err(Unreachable::NoReference));
    }
}
