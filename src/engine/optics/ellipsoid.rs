//! The hemi-ellipsoid: emergent direction u at F1 <-> viewing direction v at F2 (physics 5.1, 5.2).

use super::direction::Vec3;
use crate::error::EngineError;

/// A mirror with b = c, foci on x: F1 = (-f, 0, 0) the sample, F2 = (f, 0, 0) the camera.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ellipsoid {
    /// E = 2e/(1+e^2) of the numerical eccentricity e = f/a.
    big_e: f64,
    /// sqrt(1 - E^2).
    root: f64,
}

// === impl Ellipsoid ===

impl Ellipsoid {
    /// A mirror of numerical eccentricity `e` = f/a.
    ///
    /// # Errors
    /// `e` outside 0 <= e < 1.
    pub fn new(e: f64) -> Result<Ellipsoid, EngineError> {
        if !(0.0..1.0).contains(&e) {
            return Err(EngineError::Parameter { name: "eccentricity", value: e, allowed: "0 <= e < 1" });
        }
        let big_e = 2.0 * e / (1.0 + e * e);
        // 1 - E^2 = ((1-e^2)/(1+e^2))^2, without cancellation
        Ok(Ellipsoid { big_e, root: (1.0 - e * e) / (1.0 + e * e) })
    }

    /// Viewing direction v of the light that left the sample along `u`.
    pub fn view(&self, u: Vec3) -> Vec3 {
        Ellipsoid::map(u, self.big_e, self.root)
    }

    /// Emergent direction u of the light seen along `v`: the same map with -E.
    pub fn emergent(&self, v: Vec3) -> Vec3 {
        Ellipsoid::map(v, -self.big_e, self.root)
    }

    /// J = dO_cam/dO_sample = (1-E^2)/(1 - E u_x)^2 at emergent direction `u`.
    pub fn jacobian(&self, u: Vec3) -> f64 {
        (self.root / (1.0 - self.big_e * u.x)).powi(2)
    }

    /// dO_sample/dO_cam = (1-E^2)/(1 + E v_x)^2 at viewing direction `v`.
    pub fn inverse_jacobian(&self, v: Vec3) -> f64 {
        (self.root / (1.0 + self.big_e * v.x)).powi(2)
    }

    fn map(u: Vec3, big_e: f64, root: f64) -> Vec3 {
        let n = 1.0 / (1.0 - big_e * u.x);
        Vec3 { x: (u.x - big_e) * n, y: u.y * root * n, z: u.z * root * n }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used)]
    use super::*;
    use crate::optics::direction::Direction;

    fn sky() -> impl Iterator<Item = Vec3> {
        (0..46).flat_map(|t| {
            (0..36).map(move |p| Direction::from_degrees(2.0 * f64::from(t), 10.0 * f64::from(p)).vector())
        })
    }

    #[test]
    fn directions_return_through_the_inverse() {
        for e in [0.0, 0.1, 0.3, 0.5, 0.8] {
            let m = Ellipsoid::new(e).unwrap();
            for u in sky() {
                let v = m.view(u);
                assert!((v.dot(v) - 1.0).abs() < 1e-12, "unit vectors stay unit vectors");
                assert!(m.emergent(v).angle_to(u) < 1e-12, "e = {e}");
                assert!((m.jacobian(u) * m.inverse_jacobian(v) - 1.0).abs() < 1e-12);
            }
        }
    }

    /// A ray from F1 along u meets the shell and is reflected to F2: traced without the closed form.
    #[test]
    fn the_map_is_what_a_traced_ray_does() {
        let e = 0.3;
        let (a, f) = (1.0, e);
        let b2: f64 = a * a - f * f;
        let m = Ellipsoid::new(e).unwrap();
        for u in sky() {
            // distance from a focus along u: r1 = b^2/(a - f u_x)
            let r1 = b2 / (a - f * u.x);
            let hit = Vec3 { x: -f + r1 * u.x, y: r1 * u.y, z: r1 * u.z };
            let shell = hit.x * hit.x / (a * a) + (hit.y * hit.y + hit.z * hit.z) / b2;
            assert!((shell - 1.0).abs() < 1e-12);
            // what the camera at F2 looks along
            let v = Vec3 { x: hit.x - f, ..hit };
            assert!(m.view(u).angle_to(v) < 1e-12);
            let r2 = 2.0 * a - r1;
            assert!((m.jacobian(u) - (r1 / r2).powi(2)).abs() < 1e-12);
        }
    }

    #[test]
    fn the_jacobian_spans_k_squared() {
        for (e, low, high) in [(0.2, 0.4444, 2.25), (0.3, 0.29, 3.45), (0.5, 0.111, 9.0)] {
            let m = Ellipsoid::new(e).unwrap();
            let x = Vec3 { x: 1.0, y: 0.0, z: 0.0 };
            assert!((m.jacobian(Vec3 { x: -1.0, ..x }) / low - 1.0).abs() < 0.01);
            assert!((m.jacobian(x) / high - 1.0).abs() < 0.01);
        }
        assert!(Ellipsoid::new(1.0).is_err());
    }
}
