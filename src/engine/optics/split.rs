//! Which patches a pixel sees: one for most pixels, fractions of several where a border crosses it.

use super::basis::AngleBasis;
use super::direction::Vec3;
use super::ellipsoid::Ellipsoid;
use super::fisheye::{Fisheye, Lens};
use std::f64::consts::TAU;

/// No patch: below the horizon.
pub(crate) const NONE: u32 = u32::MAX;

/// Subsamples a side in a pixel that a border crosses.
const SUB: usize = 8;

/// Finds the patch of a unit vector without arc functions of theta.
#[derive(Debug, Clone)]
struct PatchFinder {
    cos_upper: Vec<f64>,
    first: Vec<u32>,
    around: Vec<u32>,
}

/// Light path of one pixel of one view.
#[derive(Debug, Clone)]
pub(crate) struct Path {
    lens: Lens,
    ellipsoid: Ellipsoid,
    finder: PatchFinder,
    flipped: bool,
}

/// One image point seen through lens and mirror.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Point {
    /// Patch, or `NONE`.
    pub patch: u32,
    /// Projected solid angle at the sample per pixel area, sr; zero below the horizon.
    pub projected: f64,
    /// Solid angle at the sample per pixel area, sr; zero below the horizon.
    pub solid: f64,
    /// J = dO_cam/dO_sample there.
    pub jacobian: f64,
}

/// Share of one patch in one pixel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Share {
    /// Patch.
    pub patch: u32,
    /// Projected solid angle of the share, sr.
    pub projected: f64,
    /// Solid angle of the share, sr.
    pub solid: f64,
}

// === impl PatchFinder ===

impl PatchFinder {
    fn of(basis: &AngleBasis) -> PatchFinder {
        let mut first = 0;
        let mut firsts = Vec::new();
        for ring in &basis.rings {
            firsts.push(first);
            first += ring.patches as u32;
        }
        PatchFinder {
            cos_upper: basis.rings.iter().map(|r| r.upper_deg.to_radians().cos()).collect(),
            first: firsts,
            around: basis.rings.iter().map(|r| r.patches as u32).collect(),
        }
    }

    /// Same answer as `AngleBasis::patch_of` for a unit vector with z >= 0.
    fn patch(&self, u: Vec3) -> u32 {
        let last = self.cos_upper.len().saturating_sub(1);
        let ring = self.cos_upper.iter().position(|&c| u.z > c).unwrap_or(last);
        let (Some(&first), Some(&n)) = (self.first.get(ring), self.around.get(ring)) else { return NONE };
        if n == 1 {
            return first;
        }
        let turn = u.y.atan2(u.x) / TAU;
        let k = ((turn + 1.0) * f64::from(n) + 0.5).floor() as u32 % n;
        first + k
    }
}

// === impl Path ===

impl Path {
    pub(crate) fn of(fisheye: Fisheye, ellipsoid: Ellipsoid, basis: &AngleBasis, flipped: bool) -> Path {
        Path { lens: Lens::of(fisheye), ellipsoid, finder: PatchFinder::of(basis), flipped }
    }

    /// k in radians per pixel.
    pub(crate) fn k(&self) -> f64 {
        self.lens.k()
    }

    /// What the image point (`column`, `row`) sees.
    pub(crate) fn point(&self, column: f64, row: f64) -> Point {
        let (v, d_omega_px) = self.lens.view(column, row);
        if v.z < 0.0 {
            return Point { patch: NONE, projected: 0.0, solid: 0.0, jacobian: 1.0 };
        }
        let inverse = self.ellipsoid.inverse_jacobian(v);
        let u = self.ellipsoid.emergent(v);
        // file coordinates: Side::emergent of a sample turned about the vertical
        let file = if self.flipped { Vec3 { x: -u.x, ..u } } else { u };
        let solid = d_omega_px * inverse;
        Point { patch: self.finder.patch(file), projected: solid * u.z, solid, jacobian: 1.0 / inverse }
    }

    /// Shares of the patches in the pixel centred on (`column`, `row`), by sub-sampling; in patch order.
    pub(crate) fn shares(&self, column: usize, row: usize, out: &mut Vec<Share>) {
        out.clear();
        let step = 1.0 / SUB as f64;
        let area = step * step;
        for i in 0..SUB {
            for j in 0..SUB {
                let dx = (j as f64 + 0.5) * step - 0.5;
                let dy = (i as f64 + 0.5) * step - 0.5;
                let p = self.point(column as f64 + dx, row as f64 + dy);
                if p.patch == NONE {
                    continue;
                }
                let (projected, solid) = (p.projected * area, p.solid * area);
                match out.iter_mut().find(|s| s.patch == p.patch) {
                    Some(s) => {
                        s.projected += projected;
                        s.solid += solid;
                    }
                    None => out.push(Share { patch: p.patch, projected, solid }),
                }
            }
        }
        out.sort_by_key(|s| s.patch);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optics::direction::Direction;

    #[test]
    fn the_quick_finder_agrees_with_the_basis() {
        for basis in [AngleBasis::klems_full(), AngleBasis::klems_half(), AngleBasis::klems_quarter()] {
            let finder = PatchFinder::of(&basis);
            for t in 0..180 {
                for p in 0..361 {
                    let d = Direction::from_degrees(0.5 * f64::from(t) + 0.13, f64::from(p) + 0.21);
                    assert_eq!(
                        basis.patch_of(d).map(|i| i as u32),
                        Some(finder.patch(d.vector())),
                        "{:?}",
                        d.degrees()
                    );
                }
            }
        }
    }
}
