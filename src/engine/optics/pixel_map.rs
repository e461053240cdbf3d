//! Every pixel of one view told as patches of the basis: weights, borders, Bayer channel, vignetting.
//!
//! A pixel that a patch border crosses is split by sub-sampling. For the uncertainty of directions the map also
//! keeps, for pixels near borders, how their share of a patch changes when the picture shifts by one standard
//! uncertainty of direction: by Gauss' theorem that is all a patch mean can feel of a shift, be it a gradient or a
//! peak at a border.

use super::basis::AngleBasis;
use super::ellipsoid::Ellipsoid;
use super::fisheye::Fisheye;
use super::split::{NONE, Path, Share};
use crate::error::EngineError;

/// How colour lies on the sensor.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Mosaic {
    /// Row 0: R G R G, row 1: G B G B; channels 0 = R, 1 = G, 2 = B.
    BayerRggb,
    /// Row 0: G R G R, row 1: B G B G.
    BayerGrbg,
    /// Row 0: G B G B, row 1: R G R G.
    BayerGbrg,
    /// Row 0: B G B G, row 1: G R G R.
    BayerBggr,
    /// One channel.
    Mono,
}

/// What a map is made from.
#[derive(Debug, Clone)]
pub struct PixelMapSpec {
    /// Columns of the sensor.
    pub width: usize,
    /// Rows of the sensor.
    pub height: usize,
    /// Rows from the top that carry no picture.
    pub reserved_rows: usize,
    /// Colour mosaic.
    pub mosaic: Mosaic,
    /// Lens.
    pub fisheye: Fisheye,
    /// Mirror.
    pub ellipsoid: Ellipsoid,
    /// Emergent basis.
    pub basis: AngleBasis,
    /// The sample shows its exterior side (`Side::flipped`).
    pub flipped: bool,
    /// Standard uncertainty of emergent directions, degrees.
    pub direction_u_deg: f64,
    /// Standard deviation of the point spread of lens and low-pass filter, pixels; 0 = none.
    pub blur_px: f64,
    /// c2, c4, … of VC = 1 + c2 t^2 + c4 t^4 + …, t = theta_c / 90 degrees.
    pub vignetting: Vec<f64>,
}

/// One pixel's share of one patch.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Part {
    /// Column.
    pub column: u32,
    /// channel * patches + patch.
    pub slot: u32,
    /// Projected solid angle in sr.
    pub weight: f64,
}

/// Change of a pixel's share of a patch for a shift by one standard uncertainty along columns and rows, and for the
/// point spread being applied once more.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Edge {
    pub column: u32,
    pub slot: u32,
    pub gx: f64,
    pub gy: f64,
    pub blur: f64,
}

/// Ranges of one row.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Row {
    pub columns: std::ops::Range<usize>,
    pub parts: std::ops::Range<usize>,
    pub edges: std::ops::Range<usize>,
}

/// Pixels to patches for one camera, basis and presentation of the sample.
#[derive(Debug, Clone)]
pub struct PixelMap {
    width: usize,
    height: usize,
    mosaic: Mosaic,
    patches: usize,
    rows: Vec<Row>,
    parts: Vec<Part>,
    edges: Vec<Edge>,
    gain: Vec<f64>,
    in_frame: Vec<f64>,
    sum_solid: f64,
    sum_projected: f64,
}

/// How far shifts and point spread reach, in pixels.
#[derive(Debug, Clone, Copy)]
struct Reach {
    /// Standard uncertainty of direction, radians.
    u_rad: f64,
    /// Shift for the first difference.
    shift: usize,
    /// Shift for the second difference.
    step: usize,
    /// Factor from the second difference to the effect of the point spread: variance / (2 step^2); 0 = none.
    blur: f64,
}

/// Which patches each pixel sees, while the map is being made.
struct Cover {
    width: usize,
    height: usize,
    centre: Vec<u32>,
    split: Vec<Option<Box<[Share]>>>,
}

// === impl Mosaic ===

impl Mosaic {
    /// Number of channels.
    pub fn channels(self) -> usize {
        match self {
            Mosaic::Mono => 1,
            _ => 3,
        }
    }

    /// Channel of a pixel.
    pub fn channel(self, column: usize, row: usize) -> usize {
        // Counted from a red pixel: the sum of both parities is the channel.
        let (column, row) = match self {
            Mosaic::Mono => return 0,
            Mosaic::BayerRggb => (column, row),
            Mosaic::BayerGrbg => (column + 1, row),
            Mosaic::BayerGbrg => (column, row + 1),
            Mosaic::BayerBggr => (column + 1, row + 1),
        };
        (column & 1) + (row & 1)
    }
}

// === impl PixelMap ===

impl PixelMap {
    /// Builds the map; a second or so for the large sensor, once per camera and presentation.
    ///
    /// # Errors
    /// A pixel coefficient that is not positive, a negative direction uncertainty, a vignetting that reaches zero.
    pub fn build(spec: &PixelMapSpec) -> Result<PixelMap, EngineError> {
        spec.fisheye.check()?;
        let u = spec.direction_u_deg;
        if !(u >= 0.0 && u.is_finite()) {
            let allowed = "it must be zero or positive";
            return Err(EngineError::Parameter { name: "direction_u_deg", value: u, allowed });
        }
        if !(spec.blur_px >= 0.0 && spec.blur_px < 16.0) {
            let allowed = "it must lie between 0 and 16";
            return Err(EngineError::Parameter { name: "blur_px", value: spec.blur_px, allowed });
        }
        let path = Path::of(spec.fisheye, spec.ellipsoid, &spec.basis, spec.flipped);
        let cover = Cover::of(spec, &path);
        let mut map = PixelMap {
            width: spec.width,
            height: spec.height,
            mosaic: spec.mosaic,
            patches: spec.basis.len(),
            rows: Vec::with_capacity(spec.height),
            parts: Vec::new(),
            edges: Vec::new(),
            gain: gain(spec)?,
            in_frame: vec![0.0; spec.basis.len()],
            sum_solid: 0.0,
            sum_projected: 0.0,
        };
        let reach = Reach::of(u.to_radians(), path.k(), spec.blur_px);
        for row in 0..spec.height {
            map.add_row(&cover, &path, row, &reach);
        }
        for (f, lambda) in map.in_frame.iter_mut().zip(spec.basis.projected_solid_angles()) {
            *f = (*f / lambda).min(1.0);
            // sub-sampling knows a patch of a few pixels to a percent only
            if *f > 0.98 {
                *f = 1.0;
            }
        }
        Ok(map)
    }

    fn add_row(&mut self, cover: &Cover, path: &Path, row: usize, reach: &Reach) {
        let (part0, edge0) = (self.parts.len(), self.edges.len());
        let mut span: Option<std::ops::Range<usize>> = None;
        for column in 0..self.width {
            let i = row * self.width + column;
            let channel = self.mosaic.channel(column, row) * self.patches;
            let slot = |patch: u32| (channel + patch as usize) as u32;
            let before = self.parts.len();
            let point = path.point(column as f64, row as f64);
            match cover.split.get(i) {
                Some(Some(shares)) => {
                    for s in shares.iter() {
                        self.add_part(s, column, slot(s.patch));
                    }
                }
                _ if cover.centre.get(i).is_some_and(|&p| p != NONE) => {
                    let share = Share { patch: point.patch, projected: point.projected, solid: point.solid };
                    self.add_part(&share, column, slot(point.patch));
                }
                _ => continue,
            }
            if self.parts.len() == before {
                continue;
            }
            span = Some(span.map_or(column, |s| s.start)..column + 1);
            let weight: f64 = self.parts.iter().skip(before).map(|p| p.weight).sum();
            // the map is conformal: a shift by u at the sample is u sqrt(J) / k pixels
            let scale = weight * reach.u_rad * point.jacobian.sqrt() / path.k() / (2.0 * reach.shift as f64);
            cover.gradient(column, row, reach.shift, |patch, fx, fy| {
                let (gx, gy) = (scale * fx, scale * fy);
                self.edges.push(Edge { column: column as u32, slot: slot(patch), gx, gy, blur: 0.0 });
            });
            cover.curvature(column, row, reach.step, |patch, f| {
                let blur = weight * reach.blur * f;
                self.edges.push(Edge { column: column as u32, slot: slot(patch), gx: 0.0, gy: 0.0, blur });
            });
        }
        self.rows.push(Row {
            columns: span.unwrap_or(0..0),
            parts: part0..self.parts.len(),
            edges: edge0..self.edges.len(),
        });
    }

    fn add_part(&mut self, share: &Share, column: usize, slot: u32) {
        self.parts.push(Part { column: column as u32, slot, weight: share.projected });
        self.sum_solid += share.solid;
        self.sum_projected += share.projected;
        if let Some(f) = self.in_frame.get_mut(share.patch as usize) {
            *f += share.projected;
        }
    }

    /// Pixels of a frame.
    pub fn pixels(&self) -> usize {
        self.width * self.height
    }

    /// Columns.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Rows.
    pub fn height(&self) -> usize {
        self.height
    }

    /// Number of channels.
    pub fn channels(&self) -> usize {
        self.mosaic.channels()
    }

    /// The mosaic.
    pub fn mosaic(&self) -> Mosaic {
        self.mosaic
    }

    /// Patches of the basis.
    pub fn patches(&self) -> usize {
        self.patches
    }

    /// Sum of solid angles at the sample of all pixels, sr: 2 pi if the frame holds the whole hemisphere.
    pub fn sum_solid_angle(&self) -> f64 {
        self.sum_solid
    }

    /// Sum of projected solid angles at the sample of all pixels, sr: pi if the frame holds the whole hemisphere.
    pub fn sum_projected_solid_angle(&self) -> f64 {
        self.sum_projected
    }

    /// Share of every patch that the frame holds, 0 to 1.
    pub fn in_frame(&self) -> &[f64] {
        &self.in_frame
    }

    pub(crate) fn rows(&self) -> &[Row] {
        &self.rows
    }

    pub(crate) fn parts(&self) -> &[Part] {
        &self.parts
    }

    pub(crate) fn edges(&self) -> &[Edge] {
        &self.edges
    }

    /// 1/VC of every pixel.
    pub(crate) fn gain(&self) -> &[f64] {
        &self.gain
    }
}

/// 1/VC of every pixel; outside the hemisphere that of its rim.
fn gain(spec: &PixelMapSpec) -> Result<Vec<f64>, EngineError> {
    let mut gain = Vec::with_capacity(spec.width * spec.height);
    for row in 0..spec.height {
        for column in 0..spec.width {
            let t = spec.fisheye.zenith_deg(column as f64, row as f64) / 90.0;
            let vc = vignetting(&spec.vignetting, t.min(1.0));
            if vc <= 0.0 || !vc.is_finite() {
                let allowed = "VC must stay positive over the hemisphere; check the coefficients";
                return Err(EngineError::Parameter { name: "vignetting", value: vc, allowed });
            }
            gain.push(1.0 / vc);
        }
    }
    Ok(gain)
}

/// VC = 1 + c2 t^2 + c4 t^4 + … at t = theta_c / 90 degrees: signal = scene x VC.
pub fn vignetting(even_coefficients: &[f64], t: f64) -> f64 {
    let t2 = t * t;
    1.0 + t2 * even_coefficients.iter().rev().fold(0.0, |sum, c| sum * t2 + c)
}

// === impl Reach ===

impl Reach {
    fn of(u_rad: f64, k: f64, blur_px: f64) -> Reach {
        let step = blur_px.round().max(1.0);
        Reach {
            u_rad,
            shift: (u_rad / k).round().max(1.0) as usize,
            step: step as usize,
            blur: blur_px * blur_px / (2.0 * step * step),
        }
    }
}

// === impl Cover ===

impl Cover {
    fn of(spec: &PixelMapSpec, path: &Path) -> Cover {
        let (width, height) = (spec.width, spec.height);
        let mut centre = Vec::with_capacity(width * height);
        for row in 0..height {
            for column in 0..width {
                let used = row >= spec.reserved_rows;
                centre.push(if used { path.point(column as f64, row as f64).patch } else { NONE });
            }
        }
        let mut cover = Cover { width, height, centre, split: vec![None; width * height] };
        let mut shares = Vec::new();
        for row in spec.reserved_rows..height {
            for column in 0..width {
                if cover.uniform(column, row, 1) {
                    continue;
                }
                path.shares(column, row, &mut shares);
                if let Some(s) = cover.split.get_mut(row * width + column) {
                    *s = Some(shares.clone().into_boxed_slice());
                }
            }
        }
        cover
    }

    fn at(&self, column: isize, row: isize) -> Option<usize> {
        let inside = (0..self.width as isize).contains(&column) && (0..self.height as isize).contains(&row);
        inside.then(|| row as usize * self.width + column as usize)
    }

    /// All pixel centres around see the same patch.
    fn uniform(&self, column: usize, row: usize, reach: isize) -> bool {
        let (c, r) = (column as isize, row as isize);
        let own = self.at(c, r).and_then(|i| self.centre.get(i));
        (-reach..=reach).all(|dr| {
            (-reach..=reach).all(|dc| match self.at(c + dc, r + dr) {
                Some(i) => self.centre.get(i) == own,
                None => true,
            })
        })
    }

    /// Adds the patch fractions of a pixel, times `sign`, to `out`.
    fn fractions(&self, column: isize, row: isize, sign: f64, out: &mut Vec<(u32, f64)>) {
        let Some(i) = self.at(column, row) else { return };
        let mut add = |patch: u32, f: f64| match out.iter_mut().find(|(p, _)| *p == patch) {
            Some((_, sum)) => *sum += f,
            None => out.push((patch, f)),
        };
        match (self.split.get(i), self.centre.get(i)) {
            (Some(Some(shares)), _) => {
                let sum: f64 = shares.iter().map(|s| s.solid).sum();
                shares.iter().for_each(|s| add(s.patch, sign * s.solid / sum));
            }
            (_, Some(&patch)) if patch != NONE => add(patch, sign),
            _ => {}
        }
    }

    /// Calls `found` with the change of every patch's fraction for shifts of +-`shift` pixels along columns and rows.
    fn gradient(&self, column: usize, row: usize, shift: usize, mut found: impl FnMut(u32, f64, f64)) {
        let (c, r, h) = (column as isize, row as isize, shift as isize);
        let own = self.at(c, r).and_then(|i| self.centre.get(i));
        let near = [(c + h, r), (c - h, r), (c, r + h), (c, r - h)];
        let same = |&(c, r): &(isize, isize)| {
            self.at(c, r).is_some_and(|i| self.centre.get(i) == own && matches!(self.split.get(i), Some(None)))
        };
        if near.iter().all(same) {
            return;
        }
        let (mut x, mut y) = (Vec::with_capacity(4), Vec::with_capacity(4));
        self.fractions(c + h, r, 1.0, &mut x);
        self.fractions(c - h, r, -1.0, &mut x);
        self.fractions(c, r + h, 1.0, &mut y);
        self.fractions(c, r - h, -1.0, &mut y);
        for &(patch, fx) in &x {
            let fy = y.iter().find(|(p, _)| *p == patch).map_or(0.0, |&(_, f)| f);
            found(patch, fx, fy);
        }
        for &(patch, fy) in y.iter().filter(|(p, _)| !x.iter().any(|(q, _)| q == p)) {
            found(patch, 0.0, fy);
        }
    }

    /// Calls `found` with the second difference of every patch's fraction over +-`step` pixels, columns and rows together.
    fn curvature(&self, column: usize, row: usize, step: usize, mut found: impl FnMut(u32, f64)) {
        let (c, r, h) = (column as isize, row as isize, step as isize);
        let own = self.at(c, r).and_then(|i| self.centre.get(i));
        let near = [(c + h, r), (c - h, r), (c, r + h), (c, r - h)];
        // Beyond the horizon or the frame there is no patch to exchange light with.
        let inside = |&&(c, r): &&(isize, isize)| self.at(c, r).is_some_and(|i| self.centre.get(i) != Some(&NONE));
        let whole = |i: usize| self.centre.get(i) == own && matches!(self.split.get(i), Some(None));
        if self.at(c, r).is_some_and(whole) && near.iter().all(|&(c, r)| self.at(c, r).is_some_and(whole)) {
            return;
        }
        let mut sum = Vec::with_capacity(6);
        let mut neighbours = 0.0;
        for &(c, r) in near.iter().filter(inside) {
            self.fractions(c, r, 1.0, &mut sum);
            neighbours += 1.0;
        }
        self.fractions(c, r, -neighbours, &mut sum);
        for (patch, f) in sum {
            found(patch, f);
        }
    }
}

#[cfg(test)]
pub(crate) mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used)]
    use super::*;
    use std::f64::consts::PI;

    /// A small camera for tests: a tenth of the CCD.
    pub(crate) fn small(mosaic: Mosaic) -> PixelMapSpec {
        PixelMapSpec {
            width: 140,
            height: 104,
            reserved_rows: 2,
            mosaic,
            fisheye: Fisheye { centre_x_px: 69.5, centre_y_px: 52.5, deg_per_px: 1.886, roll_deg: 0.0 },
            ellipsoid: Ellipsoid::new(0.3).unwrap(),
            basis: AngleBasis::klems_full(),
            flipped: false,
            direction_u_deg: 0.3,
            blur_px: 0.0,
            vignetting: vec![-0.1, -0.05],
        }
    }

    pub(crate) fn ccd() -> PixelMapSpec {
        PixelMapSpec {
            width: 1392,
            height: 1040,
            reserved_rows: 16,
            fisheye: Fisheye { centre_x_px: 695.5, centre_y_px: 527.5, deg_per_px: 0.1886, roll_deg: 0.4 },
            ..small(Mosaic::BayerRggb)
        }
    }

    #[test]
    fn the_hemisphere_adds_up() {
        let map = PixelMap::build(&ccd()).unwrap();
        let (solid, projected) = (map.sum_solid_angle(), map.sum_projected_solid_angle());
        assert!((solid / (2.0 * PI) - 1.0).abs() < 1e-5, "sum dO / 2 pi - 1 = {:e}", solid / (2.0 * PI) - 1.0);
        assert!((projected / PI - 1.0).abs() < 1e-4, "sum cos dO / pi - 1 = {:e}", projected / PI - 1.0);
        assert!(map.in_frame().iter().all(|&f| f == 1.0));
        let parts_per_pixel = map.parts().len() as f64 / 715_409.0;
        assert!(parts_per_pixel > 1.0 && parts_per_pixel < 1.2, "{parts_per_pixel}");
    }

    /// physics 5.3: without the Jacobian a Lambertian integral is too small by exactly 1 - e^2.
    #[test]
    fn leaving_out_the_jacobian_costs_one_minus_e_squared() {
        let spec = ccd();
        let lens = crate::optics::fisheye::Lens::of(spec.fisheye);
        let mut sum = 0.0;
        for row in (16..1040).step_by(2) {
            for column in (0..1392).step_by(2) {
                let (v, d_omega) = lens.view(column as f64, row as f64);
                if v.z > 0.0 {
                    sum += 4.0 * d_omega * spec.ellipsoid.emergent(v).z;
                }
            }
        }
        assert!((sum / PI - (1.0 - 0.09)).abs() < 3e-4, "{}", sum / PI);
    }

    #[test]
    fn a_turned_sample_mirrors_the_azimuths() {
        let spec = small(Mosaic::Mono);
        let turned = PixelMapSpec { flipped: true, ..spec.clone() };
        let (a, b) = (PixelMap::build(&spec).unwrap(), PixelMap::build(&turned).unwrap());
        let full = AngleBasis::klems_full();
        let share = |map: &PixelMap, patch: usize| -> f64 {
            map.parts().iter().filter(|p| p.slot as usize == patch).map(|p| f64::from(p.column) * p.weight).sum::<f64>()
                / map.parts().iter().filter(|p| p.slot as usize == patch).map(|p| p.weight).sum::<f64>()
        };
        let (east, west) = (full.index(5, 0), full.index(5, 12));
        assert!(share(&a, east) > share(&a, west) && share(&b, east) < share(&b, west));
        assert!((share(&a, east) - share(&b, west)).abs() < 1e-9);
    }

    #[test]
    fn shifts_conserve_light_between_patches() {
        let map = PixelMap::build(&small(Mosaic::Mono)).unwrap();
        assert!(!map.edges().is_empty());
        let mut by_pixel = std::collections::BTreeMap::new();
        for row in map.rows() {
            for e in &map.edges()[row.edges.clone()] {
                let sum = by_pixel.entry((row.parts.start, e.column)).or_insert((0.0, 0.0));
                *sum = (sum.0 + e.gx, sum.1 + e.gy);
            }
        }
        // away from the horizon a shift only moves a pixel from patch to patch
        let inner = by_pixel.iter().filter(|((_, c), _)| (45..95).contains(c)).map(|(_, s)| s.0);
        let kept = inner.clone().filter(|s| s.abs() < 1e-12).count() as f64 / inner.count() as f64;
        assert!(kept > 0.8, "{kept}");
    }

    #[test]
    fn bayer_channels_and_bad_lenses() {
        assert_eq!([(0, 0), (1, 0), (0, 1), (1, 1)].map(|(c, r)| Mosaic::BayerRggb.channel(c, r)), [0, 1, 1, 2]);
        assert!((vignetting(&[-0.1, -0.05], 0.5) - (1.0 - 0.025 - 0.003125)).abs() < 1e-15);
        let mut spec = small(Mosaic::Mono);
        spec.vignetting = vec![-2.0];
        assert!(PixelMap::build(&spec).is_err());
        spec.fisheye.deg_per_px = 0.0;
        assert!(PixelMap::build(&spec).is_err());
    }
}
