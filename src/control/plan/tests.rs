//! A plan takes every exposure exactly once, begins and ends with references, and its hash seals it.
#![allow(clippy::unwrap_used, clippy::expect_used)]

use super::build::{PlanError, build};
use super::forecast::Timing;
use super::hash::hash;
use super::*;
use crate::config::scan::{ReferenceMode, Scan};
use crate::config::testing::{instrument, scan};
use proptest::prelude::*;
use std::collections::BTreeMap;

fn plan(scan: &Scan) -> Plan {
    build(&instrument(), scan, &Timing::default()).unwrap()
}

/// Side, direction, band and exposure index of every step on the sample, with how often.
fn taken(plan: &Plan) -> BTreeMap<(Side, u64, u64, String, u32), u32> {
    let mut counts = BTreeMap::new();
    for step in &plan.steps {
        let view = &plan.views[step.view as usize];
        if let Subject::Sample { side, incident } = &view.subject {
            let band = view.band.clone().unwrap();
            let key = (*side, incident.theta.to_bits(), incident.phi.to_bits(), band, step.exposure_index);
            *counts.entry(key).or_insert(0) += 1;
        }
    }
    counts
}

#[test]
fn the_demo_takes_everything_once() {
    let scan = scan("demo");
    let plan = plan(&scan);
    let counts = taken(&plan);
    assert_eq!(counts.len(), 9 * 2 * 10 * 4);
    assert!(counts.values().all(|n| *n == 1));
    for (n, step) in plan.steps.iter().enumerate() {
        assert_eq!(step.number as usize, n);
    }
    for (n, view) in plan.views.iter().enumerate() {
        assert_eq!(view.id as usize, n);
        assert_eq!(view.band.is_none(), view.subject == Subject::Dark);
    }
    // References at the start, after 6 and 12 of 18 directions, and at the end: 4 times 2 diffusers times 10 bands.
    let references = plan.views.iter().filter(|v| matches!(v.subject, Subject::Reference { .. }));
    assert_eq!(references.count(), 4 * 2 * 10);
    let darks: Vec<&View> = plan.views.iter().filter(|v| v.subject == Subject::Dark).collect();
    assert_eq!(darks.len(), 2 * 4);
    assert!(darks.iter().all(|v| v.slot == Slot(12) && v.id < 8), "darks come first, on the blank");
    assert!(matches!(plan.views.last().unwrap().subject, Subject::Reference { .. }));
}

#[test]
fn frame_arrays_have_a_place_for_every_view_and_no_other() {
    let plan = plan(&scan("demo"));
    for array in &plan.arrays {
        let places: Vec<u32> = plan.views.iter().filter(|v| v.camera == array.camera).map(|v| v.array_index).collect();
        assert_eq!(places, (0..array.views).collect::<Vec<_>>());
        assert_eq!(array.exposures, 4);
    }
    let names: Vec<&str> = plan.arrays.iter().map(|a| a.camera.as_str()).collect();
    assert_eq!(names, ["ccd", "ingaas"]);
    let total: u32 = plan.arrays.iter().map(|a| a.views).sum();
    assert_eq!(total as usize, plan.views.len());
}

#[test]
fn the_wheel_stands_where_the_next_direction_begins() {
    let plan = plan(&scan("demo"));
    let lit: Vec<&View> = plan.views.iter().filter(|v| v.band.is_some()).collect();
    for pair in lit.windows(2).filter(|w| (w[0].tilt_deg, w[0].changer_deg) != (w[1].tilt_deg, w[1].changer_deg)) {
        assert_eq!(pair[0].slot, pair[1].slot, "a move of the table needs no turn of the wheel");
    }
}

#[test]
fn rhythms_repeat_darks_and_references_with_numbers_of_their_own() {
    let mut s = scan("one_ring");
    s.dark.every_directions = 10;
    s.dark.frames = 2;
    s.reference.every_directions = 12;
    let plan = plan(&s);
    let repeats = |wanted: fn(&Subject) -> bool| -> Vec<u32> {
        plan.views.iter().filter(|v| wanted(&v.subject)).map(|v| v.repeat).collect()
    };
    assert_eq!(repeats(|s| *s == Subject::Dark), [0, 1, 2, 3, 4, 5]);
    // After 12 of 24, not after the last and at the end besides.
    assert_eq!(repeats(|s| matches!(s, Subject::Reference { .. })), [0, 1, 2]);
    s.reference.mode = ReferenceMode::Irradiance;
    let plan = self::plan(&s);
    assert!(!plan.views.iter().any(|v| matches!(v.subject, Subject::Reference { .. })));
}

#[test]
fn a_whole_night_of_klems_full_has_every_patch_and_fits_its_forecast() {
    let plan = plan(&scan("klems_full"));
    assert_eq!(taken(&plan).len(), 145 * 2 * 11 * 5);
    let f = &plan.forecast;
    assert!(f.exposing_s > 0.0 && f.total_s() > f.exposing_s + f.moving_s);
    let bytes: u64 = plan
        .steps
        .iter()
        .map(|s| match plan.views[s.view as usize].camera.as_str() {
            "ccd" => 1392 * 1040,
            _ => 2 * 320 * 256,
        })
        .sum();
    assert_eq!(f.raw_bytes, bytes);
}

#[test]
fn a_plan_survives_its_text_and_a_changed_text_is_noticed() {
    let plan = plan(&scan("one_ring"));
    assert_eq!(plan.hash.len(), 64);
    assert_eq!(plan, self::plan(&scan("one_ring")), "the same files give the same plan");
    let text = plan.to_toml().unwrap();
    assert_eq!(Plan::from_toml(&text).unwrap(), plan);
    let changed = text.replacen("slot = 5", "slot = 6", 1);
    assert_ne!(changed, text);
    assert!(matches!(Plan::from_toml(&changed), Err(PlanError::NotReadable { .. })));
}

#[test]
fn what_the_check_refuses_has_no_plan_either() {
    let i = instrument();
    let timing = Timing::default();
    let fails = |change: fn(&mut Scan)| {
        let mut s = scan("demo");
        change(&mut s);
        build(&i, &s, &timing).unwrap_err()
    };
    assert!(matches!(fails(|s| s.exposure.ratio = 1.0), PlanError::Ladder { count: 0 }));
    assert!(matches!(fails(|s| s.exposure.longest_s = 130.0), PlanError::Exposure { .. }));
    assert!(matches!(fails(|s| s.bands.names.push("f9".into())), PlanError::NoSlot { .. }));
    assert!(matches!(fails(|s| s.incidence.sides.clear()), PlanError::Size { steps: 0 }));
    let mut other = instrument();
    other.reference.reflection = None;
    let e = build(&other, &scan("demo"), &timing).unwrap_err();
    assert_eq!(e, PlanError::NoReference { kind: "reflecting" });
    other.holder.changer = None;
    assert!(matches!(build(&other, &scan("one_ring"), &timing), Err(PlanError::Pose { .. })));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    /// Any change of any step or view gives another hash.
    #[test]
    fn the_hash_changes_with_every_step(at in any::<prop::sample::Index>(), what in 0usize..6) {
        let plan = plan(&scan("one_ring"));
        let (mut views, mut steps) = (plan.views.clone(), plan.steps.clone());
        let s = at.index(steps.len());
        let v = at.index(views.len());
        match what {
            0 => steps[s].exposure.0 += 1,
            1 => { steps.remove(s); }
            2 => steps[s].exposure_index += 1,
            3 => views[v].tilt_deg += 1e-6,
            4 => views[v].slot = Slot(views[v].slot.0 % 12 + 1),
            _ => views[v].repeat += 1,
        }
        prop_assert_ne!(hash(&views, &steps).unwrap(), plan.hash);
    }

    /// Whatever is asked for, each exposure is planned exactly once, and no view is without its steps.
    #[test]
    fn every_exposure_is_planned_exactly_once(
        angles in proptest::collection::btree_set((0u32..89, 0u32..36), 1..12),
        sides in proptest::sample::subsequence(Side::ALL.to_vec(), 1..=4),
        bands in proptest::sample::subsequence(vec!["f1", "f5", "f8", "nir1", "nir3"], 1..=5),
        rhythm in (0u32..5, 0u32..5, 1u32..3),
    ) {
        let mut s = scan("demo");
        let pole = angles.iter().filter(|a| a.0 == 0).skip(1).count();
        prop_assume!(pole == 0);
        s.incidence.directions = Some(angles.iter().map(|(t, p)| [f64::from(*t), 10.0 * f64::from(*p)]).collect());
        s.incidence.sides = sides.clone();
        s.bands.names = bands.iter().map(|b| (*b).to_owned()).collect();
        (s.dark.every_directions, s.reference.every_directions, s.dark.frames) = rhythm;
        let plan = plan(&s);
        let counts = taken(&plan);
        prop_assert_eq!(counts.len(), angles.len() * sides.len() * bands.len() * 4);
        prop_assert!(counts.values().all(|n| *n == 1));
        prop_assert_eq!(plan.steps.len(), plan.views.len() * 4);
        prop_assert!(plan.is_whole());
    }
}
