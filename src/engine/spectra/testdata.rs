//! Shipped spectra for the engine's tests.
#![allow(clippy::unwrap_used, clippy::expect_used)]

use super::curve::{Curve, Grid};
use super::filters::{GlassPlate, stack_transmittance};
use super::kernels::Kernel;
use std::path::Path;

/// Intervals of Table 1.
pub(crate) const INTERVALS_NM: [[f64; 2]; 8] = [
    [380.0, 500.0],
    [450.0, 590.0],
    [480.0, 590.0],
    [500.0, 650.0],
    [550.0, 640.0],
    [570.0, 690.0],
    [650.0, 850.0],
    [800.0, 945.0],
];

/// One column of a file below `config/spectra`.
pub(crate) fn column(file: &str, name: &str) -> Curve {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config/spectra").join(file);
    let text = std::fs::read_to_string(path).unwrap();
    let mut rows = text.lines().filter(|l| !l.starts_with('#'));
    let at = rows.next().unwrap().split(',').position(|c| c == name).unwrap();
    let cell = |row: &str, i: usize| row.split(',').nth(i).unwrap().trim().parse::<f64>().unwrap();
    let rows: Vec<&str> = rows.collect();
    Curve::new(rows.iter().map(|r| cell(r, 0)).collect(), rows.iter().map(|r| cell(r, at)).collect()).unwrap()
}

pub(crate) fn lamp() -> Curve {
    column("source/hmi_model_300_1700.csv", "value")
}

/// The filter stacks of Table 1.
pub(crate) fn table_1() -> Vec<Vec<GlassPlate>> {
    let stacks: [&[(&str, f64)]; 8] = [
        &[("GG400", 1.0), ("BG25", 2.0), ("BG39", 1.0)],
        &[("GG455", 2.0), ("BG7", 2.0)],
        &[("GG495", 2.0), ("BG7", 2.0)],
        &[("OG530", 2.0), ("BG42", 2.0)],
        &[("OG570", 2.0), ("BG39", 2.0)],
        &[("OG590", 2.0), ("BG40", 2.0)],
        &[("RG665", 2.0), ("KG1", 2.0)],
        &[("RG830", 2.0)],
    ];
    let plate = |&(name, thickness_mm): &(&str, f64)| GlassPlate {
        tau_1mm: column("filter/coloured_glass_model_tau1mm.csv", name),
        reflection_factor: 0.9135,
        thickness_mm,
    };
    stacks.iter().map(|s| s.iter().map(plate).collect()).collect()
}

/// The 24 kernels of the silicon camera behind Table 1, band by band, R G B.
pub(crate) fn kernels(grid: &Grid) -> Vec<Kernel> {
    let e = grid.sample(&lamp());
    let rho = grid.sample_clamped(&column("mirror/aluminium_evaporated_best.csv", "r15"));
    let mut out = Vec::new();
    for (i, stack) in table_1().iter().enumerate() {
        let f = stack_transmittance(grid, stack);
        for (channel, name) in ["r", "g", "b"].iter().enumerate() {
            let r = grid.sample(&column("camera/ccd_rgb_asr_model.csv", name));
            out.push(Kernel::of(grid, &format!("f{}", i + 1), channel, [&r, &e, &f, &rho]).unwrap());
        }
    }
    out
}

/// Transmittances of the ten analogues of Table 3, on the grid.
pub(crate) fn analogues(grid: &Grid) -> Vec<(String, Vec<f64>)> {
    let dir = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config/spectra/glazing");
    let mut names: Vec<String> =
        std::fs::read_dir(dir).unwrap().map(|f| f.unwrap().file_name().into_string().unwrap()).collect();
    names.retain(|n| n.starts_with("model_m"));
    names.sort();
    names
        .into_iter()
        .map(|n| {
            let curve = column(&format!("glazing/{n}"), "t");
            (n, grid.sample(&curve))
        })
        .collect()
}
