//! Angular laws of a sample's components and what they send out under one incident direction.
//!
//! All vectors are in the sample frame. Both the straight-through and the mirror direction have the in-plane part
//! p = -(s_x, s_y) of the vector s to the source, so laws are told in p and in (u_x, u_y).

use super::block::{Lookup, ScatterTable};
use super::vector::{Side, V3};
use std::f64::consts::PI;
use std::sync::Arc;

/// How one component spreads light.
#[derive(Debug, Clone)]
pub enum Law {
    /// Equal radiance everywhere: 1/pi.
    Lambertian,
    /// Straight through or mirrored, smeared by the beam's disc; with an index, scaled by the angle dependence of a
    /// clear slab of that index.
    Specular {
        /// Refractive index of the slab.
        index: Option<f64>,
    },
    /// Gaussian in direction cosines about the specular direction. Reciprocal; what would leave below the horizon is
    /// absorbed, so the hemispherical value is `lobe_mass`, 1 for narrow lobes off grazing.
    Rough {
        /// Standard deviation in direction cosines.
        width: f64,
    },
    /// Values from a file.
    Table(Arc<ScatterTable>),
}

/// What leaves under one incident direction, per unit of the component's spectrum.
#[derive(Debug, Clone)]
pub enum Emission {
    /// The same BSDF everywhere, 1/sr.
    Uniform(f64),
    /// A disc with a soft edge.
    Disc(Disc),
    /// A Gaussian in direction cosines.
    Lobe {
        /// Centre (x, y).
        centre: [f64; 2],
        /// Standard deviation.
        width: f64,
    },
    /// Values of a file.
    Table(Lookup),
}

/// The image of the lamp's disc.
#[derive(Debug, Clone, Copy)]
pub struct Disc {
    /// Middle direction.
    pub centre: V3,
    /// Half angle, radians.
    pub half_angle: f64,
    /// BSDF in the middle, 1/sr.
    pub peak: f64,
    /// Hemispherical value.
    pub total: f64,
}

/// Half width of the disc's soft edge, relative to its radius.
const SOFT: f64 = 0.15;

// === impl Law ===

impl Law {
    /// What leaves on `side` for the vector `s` to the source; `half_angle` of the beam in radians. `None` where the
    /// law has nothing on that side.
    pub fn emission(&self, side: Side, s: V3, half_angle: f64) -> Option<Emission> {
        let p = [-s.x, -s.y];
        let cos_i = s.z.abs();
        if cos_i < 1e-6 {
            return None;
        }
        match self {
            Law::Lambertian => Some(Emission::Uniform(1.0 / PI)),
            Law::Specular { index } => {
                let total = index.map_or(1.0, |n| slab_factor(n, cos_i, side.is_transmission()));
                // Area of the soft disc; L = total E_perpendicular / area, BSDF = L / (E_perpendicular cos_i).
                let area = PI * half_angle * half_angle * (1.0 + SOFT * SOFT / 3.0);
                let centre = V3::new(p[0], p[1], side.emergent_sign() * cos_i);
                Some(Emission::Disc(Disc { centre, half_angle, peak: total / (area * cos_i), total }))
            }
            Law::Rough { width } => Some(Emission::Lobe { centre: p, width: *width }),
            Law::Table(table) => table.lookup(side, p).map(Emission::Table),
        }
    }
}

// === impl Emission ===

impl Emission {
    /// BSDF in direction `u` (unit, sample frame, on the emergent side), 1/sr.
    pub fn at(&self, u: V3) -> f64 {
        match self {
            Emission::Uniform(g) => *g,
            Emission::Disc(disc) => disc.at(u),
            Emission::Lobe { centre, width } => {
                let (dx, dy) = (u.x - centre[0], u.y - centre[1]);
                let w2 = width * width;
                (-0.5 * (dx * dx + dy * dy) / w2).exp() / (2.0 * PI * w2)
            }
            Emission::Table(lookup) => lookup.at([u.x, u.y]),
        }
    }

    /// Direct-hemispherical value.
    pub fn hemispherical(&self) -> f64 {
        match self {
            Emission::Uniform(g) => g * PI,
            Emission::Disc(disc) => disc.total,
            Emission::Lobe { centre, width } => lobe_mass(centre[0].hypot(centre[1]), *width),
            Emission::Table(lookup) => lookup.hemispherical(),
        }
    }
}

// === impl Disc ===

impl Disc {
    /// BSDF in direction `u`.
    pub fn at(&self, u: V3) -> f64 {
        let d = u - self.centre;
        let reach = self.reach();
        let chord2 = d.dot(d);
        if chord2 >= reach * reach {
            return 0.0;
        }
        let edge = (self.half_angle * (1.0 + SOFT) - chord2.sqrt()) / (2.0 * SOFT * self.half_angle);
        self.peak * edge.clamp(0.0, 1.0)
    }

    /// Angle beyond which it is dark, radians.
    pub fn reach(&self) -> f64 {
        self.half_angle * (1.0 + SOFT)
    }

    /// Points of a polar quadrature over the disc with their share of the hemispherical value.
    pub fn points(&self) -> Vec<(V3, f64)> {
        let (rings, around) = (60, 90);
        let aside = if self.centre.x.abs() < 0.9 { V3::new(1.0, 0.0, 0.0) } else { V3::new(0.0, 1.0, 0.0) };
        let e1 = self.centre.cross(aside).unit();
        let e2 = self.centre.cross(e1);
        let mut points = Vec::with_capacity(rings * around);
        for i in 0..rings {
            let r = self.reach() * (i as f64 + 0.5) / rings as f64;
            for k in 0..around {
                let phi = 2.0 * PI * (k as f64 + 0.5) / around as f64;
                let u = (self.centre + e1 * (r * phi.cos()) + e2 * (r * phi.sin())).unit();
                let solid = 2.0 * PI * r * self.reach() / (rings * around) as f64;
                points.push((u, self.at(u) * u.z.abs() * solid));
            }
        }
        let sum: f64 = points.iter().map(|p| p.1).sum();
        points.iter_mut().for_each(|p| p.1 *= self.total / sum.max(1e-300));
        points
    }
}

/// Part of a Gaussian of standard deviation `width`, centred `d` from the middle, that lies in the unit disc.
pub fn lobe_mass(d: f64, width: f64) -> f64 {
    let (steps, top) = (4000, (8.0 * width).min(2.0));
    let h = top / f64::from(steps);
    let inside = |rho: f64| {
        if rho <= 1.0 - d {
            1.0
        } else if rho >= 1.0 + d || d == 0.0 {
            0.0
        } else {
            ((d * d + rho * rho - 1.0) / (2.0 * d * rho)).clamp(-1.0, 1.0).acos() / PI
        }
    };
    let ring = |rho: f64| rho / (width * width) * (-0.5 * (rho / width).powi(2)).exp() * inside(rho);
    (0..steps).map(|i| ring((f64::from(i) + 0.5) * h) * h).sum()
}

/// Angle dependence of a clear slab of index `n` (both faces, all orders, unpolarised), relative to normal incidence.
fn slab_factor(n: f64, cos_i: f64, transmission: bool) -> f64 {
    let value = |c: f64| {
        let ct = (1.0 - (1.0 - c * c) / (n * n)).max(0.0).sqrt();
        let rs = ((c - n * ct) / (c + n * ct)).powi(2);
        let rp = ((n * c - ct) / (n * c + ct)).powi(2);
        let slab = |r: f64| if transmission { (1.0 - r) / (1.0 + r) } else { 2.0 * r / (1.0 + r) };
        0.5 * (slab(rs) + slab(rp))
    };
    value(cos_i) / value(1.0)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used)]
    use super::*;

    /// Integrates BSDF cos over the hemisphere on a grid in direction cosines.
    fn integral(e: &Emission, sign: f64, n: i32) -> f64 {
        let h = 2.0 / f64::from(n);
        let mut sum = 0.0;
        for i in 0..n {
            for k in 0..n {
                let (x, y) = (-1.0 + h * (f64::from(i) + 0.5), -1.0 + h * (f64::from(k) + 0.5));
                let z2 = 1.0 - x * x - y * y;
                if z2 > 0.0 {
                    sum += h * h * e.at(V3::new(x, y, sign * z2.sqrt()));
                }
            }
        }
        sum
    }

    #[test]
    fn lobes_carry_their_hemispherical_value() {
        for (theta, width) in [(0.0, 0.1), (40.0, 0.05), (60.0, 0.2), (80.0, 0.1)] {
            let side = Side::TransmissionFront;
            let s = side.source_vector(theta, 200.0);
            let e = Law::Rough { width }.emission(side, s, 0.004).unwrap();
            let total = integral(&e, 1.0, 1500);
            assert!((total / e.hemispherical() - 1.0).abs() < 2e-3, "{theta} {width}: {total}");
        }
        assert!((lobe_mass(0.0, 0.1) - 1.0).abs() < 1e-6);
        assert!((lobe_mass(1.0, 0.02) - 0.5).abs() < 0.01);
    }

    #[test]
    fn a_specular_component_carries_its_value_whatever_the_incidence() {
        for theta in [0.0, 30.0, 70.0] {
            for side in [Side::TransmissionFront, Side::ReflectionFront] {
                let s = side.source_vector(theta, 33.0);
                let e = Law::Specular { index: None }.emission(side, s, 1.0f64.to_radians()).unwrap();
                let total = integral(&e, side.emergent_sign(), 4000);
                assert!((total - 1.0).abs() < 3e-3, "{theta} {side:?}: {total}");
            }
        }
    }

    #[test]
    fn a_slab_reflects_all_and_passes_nothing_at_grazing() {
        assert!((slab_factor(1.52, 1.0, true) - 1.0).abs() < 1e-12);
        assert!(slab_factor(1.52, 1e-4, true) < 0.01);
        let at_normal = 2.0 * 0.0426 / 1.0426;
        assert!((slab_factor(1.52, 1e-4, false) * at_normal - 1.0).abs() < 0.01);
    }

    /// Straight through and mirrored leave along -s in the plane, on the right side.
    #[test]
    fn specular_goes_straight_on_or_mirrors() {
        for side in Side::ALL {
            let s = side.source_vector(35.0, 120.0);
            let Some(Emission::Disc(disc)) = Law::Specular { index: None }.emission(side, s, 0.004) else {
                panic!("no disc");
            };
            let wanted = if side.is_transmission() { -s } else { V3::new(-s.x, -s.y, s.z) };
            assert!((disc.centre - wanted).norm() < 1e-12, "{side:?}");
            assert_eq!(Side::of(s, disc.centre), side);
        }
    }
}
