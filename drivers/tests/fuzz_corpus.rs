//! Promise: no bytes from a wire make a driver panic, stay away or accept what its own encoder contradicts. Replays the
//! corpora of `fuzz/` and mutations of them; `fuzz/README.md`.
#![allow(clippy::unwrap_used, clippy::expect_used)]

#[path = "../../fuzz/targets/harness.rs"]
mod harness;
#[path = "../../fuzz/targets/protocols.rs"]
mod protocols;
#[path = "../../fuzz/targets/session.rs"]
mod session;
#[path = "../../fuzz/targets/wires.rs"]
mod wires;

use goniod_drivers::table::{DRIVERS, Make};
use std::path::PathBuf;

fn corpus() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../fuzz/corpus")
}

#[test]
fn what_is_read_from_a_wire_writes_itself_as_it_came() {
    harness::replay(&corpus(), protocols::TARGETS);
}

#[test]
fn every_driver_comes_back_whatever_is_said_to_it() {
    harness::replay(&corpus(), wires::TARGETS);
}

#[test]
fn every_driver_on_a_wire_has_a_target() {
    for driver in DRIVERS.iter().filter(|d| !matches!(d.make, Make::Camera(_))) {
        let name = format!("wire-{}", driver.name);
        assert!(wires::TARGETS.iter().any(|t| t.name == name), "{name} is missing in fuzz/targets/wires.rs");
    }
}
