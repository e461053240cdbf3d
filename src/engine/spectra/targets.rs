//! What a total is weighted with: g on the grid, any scale (the combination normalises it).

use super::curve::{Curve, Grid};

/// Lamp-weighted radiometric total over an interval, eq. (14): g = E inside [lo, hi] nm. `lamp` is E on the grid.
pub fn radiometric(grid: &Grid, lamp: &[f64], interval_nm: [f64; 2]) -> Vec<f64> {
    grid.interval(interval_nm).iter().zip(lamp).map(|(w, e)| w * e).collect()
}

/// Filter-weighted band mean: g = E F. `lamp` and `filter` are on the grid.
pub fn band(lamp: &[f64], filter: &[f64]) -> Vec<f64> {
    lamp.iter().zip(filter).map(|(e, f)| e * f).collect()
}

/// Visible: g = D65 x V(lambda).
pub fn visible(grid: &Grid, d65: &Curve, v: &Curve) -> Vec<f64> {
    grid.wavelengths().map(|w| d65.at(w) * v.at(w)).collect()
}

/// Solar: g = G173 direct over the measured interval, integrated over the cells of the grid.
pub fn solar(grid: &Grid, g173_direct: &Curve, [lo, hi]: [f64; 2]) -> Vec<f64> {
    let h = 0.5 * grid.step_nm;
    grid.wavelengths().map(|w| g173_direct.integrate((w - h).max(lo), (w + h).min(hi))).collect()
}

/// Share of the sun's power between 300 and 2500 nm that lies inside the measured interval; the rest is extrapolated.
pub fn solar_share(g173_direct: &Curve, [lo, hi]: [f64; 2]) -> f64 {
    g173_direct.integrate(lo, hi) / g173_direct.integrate(300.0, 2500.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::spectra::testdata;

    #[test]
    fn targets_weigh_what_they_name() {
        let grid = Grid::engine();
        let at = |nm: f64| ((nm - grid.start_nm) / grid.step_nm) as usize;
        let total = radiometric(&grid, &vec![2.0; grid.len], [380.0, 945.0]);
        assert!((total.iter().sum::<f64>() - 1130.0).abs() < 1e-9);
        let d65 = testdata::column("source/cie_d65.csv", "value");
        let y = visible(&grid, &d65, &testdata::column("observer/cie1924_v_1nm.csv", "value"));
        assert!(y[at(555.0)] > 50.0 * y[at(430.0)] && y[at(800.0)] == 0.0);
        let sun = testdata::column("solar/astm_g173_direct.csv", "value");
        let g = solar(&grid, &sun, [380.0, 1700.0]);
        assert!((g.iter().sum::<f64>() / sun.integrate(380.0, 1700.0) - 1.0).abs() < 1e-9);
        let share = solar_share(&sun, [380.0, 1700.0]);
        assert!(share > 0.9 && share < 0.97, "{share}");
        assert_eq!(band(&[2.0, 3.0], &[0.5, 0.0]), vec![1.0, 0.0]);
    }
}
