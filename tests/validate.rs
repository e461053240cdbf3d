//! Promise: what was put on the bench comes back. A Lambertian, a clear glazing and a prism through the whole chain
//! (protocols, photographs, archive, reduction) on benches that differ from their calibration as the calibration says
//! they may; the truth comes from the simulator's own tables. `make validate` prints the table.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout)]

mod common;

use common::Lab;
use goniod::engine::bsdf::set::{BsdfSet, Column, Quantity};
use goniod::engine::optics::side::Side;
use goniod::products::reduce::{Run, reduce};
use goniod_sim::truth::expect::{Expectation, Incidence, Patch};
use goniod_sim::truth::sample::Sample;
use goniod_sim::truth::vector;
use std::path::Path;

/// Largest error of a direct-hemispherical value where the exposures suffice, relative.
const HEMISPHERICAL: f64 = 0.015;

/// Share of patches within k = 2 where the parts of the uncertainty are many and none is the greatest by far.
const COVERAGE: [f64; 2] = [0.93, 0.99];

/// The same where the greatest part, the response's or the dark's, is common to all patches and a bound more than a spread.
const BOUNDED: [f64; 2] = [0.93, 1.0];

struct Case {
    name: &'static str,
    sample: &'static str,
    directions: &'static str,
    sides: &'static str,
    shortest_s: &'static str,
    longest_s: &'static str,
    /// The colour camera with all its pixels: needed where the sample has structure as fine as a pixel.
    whole_camera: bool,
    /// Benches, each built differently within the stated uncertainties.
    seeds: u64,
    /// Largest error of a direct-hemispherical value, relative.
    worst: f64,
    /// Least and greatest share of patches within k = 2.
    coverage: [f64; 2],
}

const CASES: [Case; 4] = [
    Case {
        name: "Lambertian T 0.2",
        sample: "lambertian_t20",
        directions: "[[0, 180], [40, 90], [70, 300]]",
        sides: r#""transmission-front", "reflection-front""#,
        shortest_s: "0.008",
        longest_s: "32.768",
        whole_camera: false,
        seeds: 20,
        worst: HEMISPHERICAL,
        coverage: BOUNDED,
    },
    // Blue sees little through f4 and f6, the dark frames are black: what is not known is told, and is not weighed.
    Case {
        name: "the same, too dim",
        sample: "lambertian_t20",
        directions: "[[0, 180], [40, 90], [70, 300]]",
        sides: r#""transmission-front", "reflection-front""#,
        shortest_s: "0.004",
        longest_s: "0.5",
        whole_camera: false,
        seeds: 6,
        worst: 0.10,
        coverage: BOUNDED,
    },
    Case {
        name: "clear glazing 3 mm",
        sample: "clear_glazing",
        directions: "[[0, 180], [30, 180], [60, 180]]",
        sides: r#""transmission-front", "reflection-front""#,
        shortest_s: "0.0000038",
        longest_s: "64.0",
        whole_camera: true,
        seeds: 3,
        worst: HEMISPHERICAL,
        coverage: COVERAGE,
    },
    Case {
        name: "prism film",
        sample: "prism42",
        directions: "[[0, 180], [40, 270], [60, 90]]",
        sides: r#""transmission-front", "reflection-front", "transmission-back""#,
        shortest_s: "0.0002",
        longest_s: "64.0",
        whole_camera: true,
        seeds: 3,
        worst: HEMISPHERICAL,
        coverage: COVERAGE,
    },
];

/// What came back of one case over all benches.
#[derive(Default)]
struct Tally {
    hemispherical_worst: f64,
    hemispherical_rms: f64,
    hemispherical_n: usize,
    /// |measured - true| / (2 u) of every patch of every headline column.
    within: usize,
    patches: usize,
    /// The same for hemispherical values.
    sums_within: usize,
}

fn scan(case: &Case) -> String {
    format!(
        r#"name = "{name}"
[sample]
thickness_mm = 3.0
simulated = "../sim/samples/{sample}.toml"
[incidence]
directions = {directions}
sides = [{sides}]
[bands]
use = ["f1", "f2", "f4", "f6"]
[exposure]
policy = "ladder"
ratio = 8.0
shortest_s = {shortest}
longest_s = {longest}
"#,
        name = case.name,
        sample = case.sample,
        directions = case.directions,
        sides = case.sides,
        shortest = case.shortest_s,
        longest = case.longest_s,
    )
}

/// Spectral weights of a quantity, (nm, weight), from the shipped tables read here by hand.
fn weights(quantity: &Quantity) -> Option<Vec<(f64, f64)>> {
    match quantity {
        Quantity::Visible => {
            let (d65, v) = (table("source/cie_d65.csv"), table("observer/cie1924_v_1nm.csv"));
            Some((380..=780).map(|nm| (nm as f64, at(&d65, nm as f64) * at(&v, nm as f64))).collect())
        }
        _ => None,
    }
}

fn table(name: &str) -> Vec<(f64, f64)> {
    let text = std::fs::read_to_string(common::root().join("config/spectra").join(name)).unwrap();
    let rows = text.lines().filter(|l| l.starts_with(|c: char| c.is_ascii_digit()));
    rows.map(|l| {
        let mut cells = l.split(',').map(|c| c.trim().parse::<f64>().unwrap());
        (cells.next().unwrap(), cells.next().unwrap())
    })
    .collect()
}

fn at(table: &[(f64, f64)], nm: f64) -> f64 {
    let i = table.partition_point(|r| r.0 <= nm);
    match (i.checked_sub(1).and_then(|k| table.get(k)), table.get(i)) {
        (Some(a), Some(b)) => a.1 + (b.1 - a.1) * (nm - a.0) / (b.0 - a.0),
        (Some(a), None) if a.0 == nm => a.1,
        _ => 0.0,
    }
}

fn truth_side(side: Side) -> vector::Side {
    match side {
        Side::TransmissionFront => vector::Side::TransmissionFront,
        Side::ReflectionFront => vector::Side::ReflectionFront,
        Side::TransmissionBack => vector::Side::TransmissionBack,
        Side::ReflectionBack => vector::Side::ReflectionBack,
    }
}

/// True patch means and the true hemispherical value of a column.
fn truth(set: &BsdfSet, column: &Column, sample: &Sample, weights: &[(f64, f64)]) -> (Vec<f64>, f64) {
    let expectation = Expectation::new(sample, 0.25);
    let (theta_deg, phi_deg) = column.incident.degrees();
    let incidence = Incidence { side: truth_side(column.side), theta_deg, phi_deg };
    let mut patches = Vec::new();
    for ring in &set.basis.rings {
        for k in 0..ring.patches {
            let patch = Patch {
                theta_low_deg: ring.lower_deg,
                theta_high_deg: ring.upper_deg,
                phi_deg: 360.0 * k as f64 / ring.patches as f64,
                phi_width_deg: 360.0 / ring.patches as f64,
            };
            patches.push(expectation.patch_mean(incidence, &patch, weights));
        }
    }
    (patches, expectation.hemispherical(incidence, weights))
}

impl Tally {
    fn take(&mut self, set: &BsdfSet, column: &Column, sample: &Sample, weights: &[(f64, f64)], verbose: bool) {
        let (patches, sum) = truth(set, column, sample, weights);
        let error = column.hemispherical / sum - 1.0;
        if verbose || error.abs() > 2.0 * column.hemispherical_u / sum {
            let (theta, phi) = column.incident.degrees();
            println!(
                "    {:?} at ({theta:.0}, {phi:.0}): true {sum:.5}, measured {:.5} ± {:.5} (k = 2), {:+.2} %",
                column.side,
                column.hemispherical,
                2.0 * column.hemispherical_u,
                100.0 * error
            );
        }
        self.hemispherical_worst = self.hemispherical_worst.max(error.abs());
        self.hemispherical_rms += error * error;
        self.hemispherical_n += 1;
        self.sums_within += usize::from((column.hemispherical - sum).abs() <= 2.0 * column.hemispherical_u);
        for (i, (p, t)) in column.patches.iter().zip(&patches).enumerate() {
            assert!(p.bsdf.is_finite() && p.u > 0.0, "every patch has a value and an uncertainty");
            let inside = (p.bsdf - t).abs() <= 2.0 * p.u;
            if (std::env::var("GONIOD_VERBOSE").as_deref() == Ok("all") || !inside)
                && std::env::var_os("GONIOD_VERBOSE").is_some()
            {
                println!(
                    "      patch {i}: true {t:.5} measured {:.3e} u {:.3e} ({:+.2} u)",
                    p.bsdf,
                    p.u,
                    (p.bsdf - t) / p.u
                );
            }
            self.within += usize::from(inside);
            self.patches += 1;
        }
    }
}

fn validate(case: &Case, lab: &Lab) -> Tally {
    let sample_file = lab.path("config/sim/samples").join(format!("{}.toml", case.sample));
    let sample = Sample::read(&sample_file).unwrap();
    let scan_file = lab.scan(&format!("{}.toml", case.sample), &scan(case));
    let mut tally = Tally::default();
    for seed in 1..=case.seeds {
        let runs = format!("runs/{}-{seed}", case.sample);
        let path = lab.rehearse(&scan_file, &runs, &["--seed", &seed.to_string(), "--no-products"]);
        let set = reduced(&path);
        for column in &set.columns {
            if let Some(weights) = set.quantities.get(column.quantity).and_then(weights) {
                tally.take(&set, column, &sample, &weights, seed == 1);
            }
        }
        std::fs::remove_dir_all(path).unwrap();
    }
    tally
}

fn reduced(path: &Path) -> BsdfSet {
    reduce(&Run::open(path).unwrap()).unwrap().set
}

#[test]
fn what_was_put_on_the_bench_comes_back() {
    let mut rows = Vec::new();
    let mut failed = Vec::new();
    for case in &CASES {
        println!("{}", case.name);
        let lab = if case.whole_camera { Lab::shipped() } else { Lab::small() };
        let t = validate(case, &lab);
        let coverage = t.within as f64 / t.patches as f64;
        rows.push(format!(
            "{:<20} {:>7} {:>5} {:>9.2} {:>9.2} {:>9.1} {:>8} {:>9.1}",
            case.name,
            case.seeds,
            t.hemispherical_n,
            100.0 * (t.hemispherical_rms / t.hemispherical_n as f64).sqrt(),
            100.0 * t.hemispherical_worst,
            100.0 * t.sums_within as f64 / t.hemispherical_n as f64,
            t.patches,
            100.0 * coverage,
        ));
        if t.hemispherical_worst > case.worst {
            failed.push(format!("{}: hemispherical error {:.2} %", case.name, 100.0 * t.hemispherical_worst));
        }
        if !(case.coverage[0]..=case.coverage[1]).contains(&coverage) {
            failed.push(format!("{}: {:.1} % of patches within k = 2", case.name, 100.0 * coverage));
        }
        if (t.sums_within as f64) < case.coverage[0] * t.hemispherical_n as f64 {
            failed.push(format!("{}: {} of {} sums within k = 2", case.name, t.sums_within, t.hemispherical_n));
        }
    }
    println!("\nVisible                               hemispherical, %             patches");
    println!("sample               benches  sums       rms     worst  in k=2 %   number  in k=2 %");
    println!("{}", rows.join("\n"));
    assert!(failed.is_empty(), "{}", failed.join("; "));
}
