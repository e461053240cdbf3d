//! Promise: a scan runs alike whatever the bench is made of; the instrument file names other drivers, nothing else changes.
#![allow(clippy::unwrap_used, clippy::expect_used)]

mod common;

use common::{Lab, text};

/// One view a band, places that a nine-place wheel has, dark frames by the shutter.
const SCAN: &str = r#"
name = "other devices"
[sample]
thickness_mm = 4.0
simulated = "../sim/samples/rough_glass.toml"
[incidence]
directions = [[0, 180]]
sides = ["transmission-front"]
[bands]
use = ["f1", "f4"]
[exposure]
policy = "ladder"
ratio = 8.0
shortest_s = 0.004
longest_s = 0.5
[products]
formats = ["hdf5"]
"#;

/// A small lab whose wheel has nine places and no blank one.
fn lab() -> Lab {
    let lab = Lab::small();
    let file = lab.instrument();
    let whole = std::fs::read_to_string(&file).unwrap();
    let from = whole.find("[filter_wheel.slot.10]").unwrap();
    let to = whole.find("[shutter]").unwrap();
    std::fs::write(&file, format!("{}{}", &whole[..from], &whole[to..])).unwrap();
    lab.edit("instrument.sim.toml", &[("places = 12", "places = 9")], true);
    lab
}

#[test]
fn newport_optec_and_uniblitz_give_what_zaber_and_thorlabs_give() {
    let lab = lab();
    let scan = lab.scan("other.toml", SCAN);
    let usual = lab.rehearse(&scan, "usual", &[]);
    lab.edit(
        "instrument.sim.toml",
        &[
            ("\"zaber-ascii\"", "\"newport-esp301\""),
            ("device = 2\naxis = 1", "device = 1\naxis = 2"),
            ("device = 3\naxis = 1", "device = 1\naxis = 3"),
            ("\"thorlabs-fw212c\"", "\"optec-ifw\""),
            ("\"thorlabs-sc10\"", "\"uniblitz-vcm-d1\""),
        ],
        true,
    );
    let other = lab.rehearse(&scan, "other", &[]);
    for run in [&usual, &other] {
        let verified = lab.goniod(&["verify", &text(run), "--json"]);
        assert_eq!(verified.code, 0, "{}{}", verified.out, verified.err);
    }
    let stored = |runs: &str| lab.goniod(&["status", "--runs", runs, "--json"]).json()["runs"][0]["stored"].clone();
    assert_eq!(stored("usual"), stored("other"));
    assert!(other.join("products/bsdf.h5").is_file());
}
