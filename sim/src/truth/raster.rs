//! What the pixels of one camera see: emergent directions once a camera, BSDF fields once a pose.

use super::law::{Disc, Emission};
use super::mirror::Collector;
use super::vector::V3;
use rayon::prelude::*;

/// Directions and factors of all pixels, row by row.
#[derive(Debug)]
pub struct Raster {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    reserved_rows: usize,
    u: Vec<[f32; 3]>,
    /// Factor on radiance (vignetting, lit part); 0 beyond the hemisphere.
    pub factor: Vec<f32>,
}

/// BSDF of one component over the pixels, 1/sr.
#[derive(Debug)]
pub enum Field {
    /// The same everywhere.
    Uniform(f64),
    /// A few pixels: (index, value), rising index.
    Sparse(Vec<(u32, f64)>),
    /// All pixels.
    Dense(Vec<f32>),
}

/// Relative second difference above which a pixel is sampled finer.
const STRUCTURE: f32 = 0.01;
/// Values below this part of the largest are never sampled finer.
const FAINT: f32 = 1e-4;

// === impl Raster ===

impl Raster {
    /// Traces all pixels below the reserved rows.
    pub fn new(collector: &Collector, width: usize, height: usize, reserved_rows: usize) -> Raster {
        let mut u = vec![[0.0f32; 3]; width * height];
        let mut factor = vec![0.0f32; width * height];
        u.par_chunks_mut(width).zip(factor.par_chunks_mut(width)).enumerate().skip(reserved_rows).for_each(
            |(row, (directions, factors))| {
                for (column, (direction, factor)) in directions.iter_mut().zip(factors).enumerate() {
                    if let Some(sight) = collector.sight(column as f64, row as f64) {
                        *direction = [sight.u.x as f32, sight.u.y as f32, sight.u.z as f32];
                        *factor = sight.factor as f32;
                    }
                }
            },
        );
        Raster { width, height, reserved_rows, u, factor }
    }

    /// Emergent direction of a pixel in the camera frame; `None` beyond the hemisphere.
    pub fn direction(&self, index: usize) -> Option<V3> {
        let [x, y, z] = *self.u.get(index)?;
        (z > 0.0).then(|| V3::new(f64::from(x), f64::from(y), f64::from(z)))
    }

    /// The field of an emission told in the sample frame; `turned` where the sample is turned about y.
    pub fn field(&self, collector: &Collector, emission: &Emission, turned: bool) -> Field {
        match emission {
            Emission::Uniform(g) => Field::Uniform(*g),
            Emission::Disc(disc) => Field::Sparse(self.disc(collector, disc, turned)),
            Emission::Lobe { .. } | Emission::Table(_) => {
                Field::Dense(self.dense(collector, &|u| emission.at(if turned { u.turned() } else { u })))
            }
        }
    }

    /// Pixels that see a disc, sampled as fine as its soft edge needs.
    fn disc(&self, collector: &Collector, disc: &Disc, turned: bool) -> Vec<(u32, f64)> {
        let centre = if turned { disc.centre.turned() } else { disc.centre };
        let (column, row) = collector.nominal_pixel(centre);
        let pitch = collector.pitch(centre);
        // A degree more for pointing errors and pupil walk; image scale changes by less than two over the box.
        let radius = 2.0 * (disc.reach() + 1.5f64.to_radians()) / pitch + 3.0;
        let span = |middle: f64, end: usize| {
            let low = (middle - radius).floor().max(0.0) as usize;
            low..((middle + radius).ceil().max(0.0) as usize + 1).min(end)
        };
        let fine = ((8.0 * pitch / disc.half_angle).ceil() as usize).clamp(4, 40);
        let rows = span(row, self.height);
        let mut lit = Vec::new();
        for r in rows.start.max(self.reserved_rows)..rows.end {
            for c in span(column, self.width) {
                let index = r * self.width + c;
                let Some(u) = self.direction(index) else { continue };
                if (u - centre).norm() > disc.reach() + 3.0 * pitch {
                    continue;
                }
                let g = supersample(collector, c, r, fine, &|u| disc.at(if turned { u.turned() } else { u }));
                if g > 0.0 {
                    lit.push((index as u32, g));
                }
            }
        }
        lit
    }

    /// One sample a pixel, then finer where the field bends.
    fn dense(&self, collector: &Collector, g: &(dyn Fn(V3) -> f64 + Sync)) -> Vec<f32> {
        let w = self.width;
        let mut values = vec![0.0f32; w * self.height];
        values.par_chunks_mut(w).enumerate().skip(self.reserved_rows).for_each(|(row, out)| {
            for (column, value) in out.iter_mut().enumerate() {
                if let Some(u) = self.direction(row * w + column) {
                    *value = g(u) as f32;
                }
            }
        });
        let largest = values.par_iter().copied().reduce(|| 0.0, f32::max);
        let rough: Vec<(usize, f32)> = (self.reserved_rows.max(1)..self.height - 1)
            .into_par_iter()
            .flat_map_iter(|row| {
                let values = &values;
                (1..w - 1).filter_map(move |column| {
                    let index = row * w + column;
                    if self.factor[index] <= 0.0 || !self.bends(values, index, largest) {
                        return None;
                    }
                    let pitch = collector.pitch(self.direction(index)?);
                    let fine = if pitch > 0.5f64.to_radians() { 6 } else { 4 };
                    Some((index, self.refine(collector, index, fine, g) as f32))
                })
            })
            .collect();
        for (index, value) in rough {
            values[index] = value;
        }
        values
    }

    /// Mean of `g` over `fine` x `fine` places of a pixel whose directions follow from the neighbours' by straight
    /// lines (error under 0.01 degrees at the coarsest pixels); at the rim every place is traced.
    fn refine(&self, collector: &Collector, index: usize, fine: usize, g: &dyn Fn(V3) -> f64) -> f64 {
        let (w, here) = (self.width, self.direction(index));
        let near = [index - 1, index + 1, index - w, index + w].map(|i| self.direction(i));
        let (Some(here), [Some(left), Some(right), Some(up), Some(down)]) = (here, near) else {
            return supersample(collector, index % w, index / w, fine, g);
        };
        let (along, across) = ((right - left) * 0.5, (down - up) * 0.5);
        let place = |i: usize| (i as f64 + 0.5) / fine as f64 - 0.5;
        let mut sum = 0.0;
        for i in 0..fine {
            for k in 0..fine {
                sum += g((here + along * place(k) + across * place(i)).unit());
            }
        }
        sum / (fine * fine) as f64
    }

    fn bends(&self, values: &[f32], index: usize, largest: f32) -> bool {
        let here = values[index];
        let w = self.width;
        [1, w, w + 1, w - 1].iter().any(|&step| {
            let seen = |i: usize| if self.factor[i] > 0.0 { values[i] } else { here };
            let (before, after) = (seen(index - step), seen(index + step));
            let local = here.max(before).max(after);
            local > FAINT * largest && (before - 2.0 * here + after).abs() > STRUCTURE * local
        })
    }
}

/// Mean of `g` over `fine` x `fine` places of a pixel; places beyond the hemisphere count as dark.
fn supersample(collector: &Collector, column: usize, row: usize, fine: usize, g: &dyn Fn(V3) -> f64) -> f64 {
    let place = |i: usize| (i as f64 + 0.5) / fine as f64 - 0.5;
    let mut sum = 0.0;
    for i in 0..fine {
        for k in 0..fine {
            if let Some(sight) = collector.sight(column as f64 + place(k), row as f64 + place(i)) {
                sum += g(sight.u);
            }
        }
    }
    sum / (fine * fine) as f64
}
