//! Any target under libFuzzer; `GONIOD_TARGET` names it.
#![no_main]

#[path = "../targets/harness.rs"]
mod harness;
#[path = "../targets/house.rs"]
mod house;
#[path = "../targets/protocols.rs"]
mod protocols;
#[path = "../targets/requests.rs"]
mod requests;
#[path = "../targets/session.rs"]
mod session;
#[path = "../targets/wires.rs"]
mod wires;

use harness::Target;
use std::sync::OnceLock;

/// The target that the environment names.
fn target() -> &'static Target {
    static CHOSEN: OnceLock<&'static Target> = OnceLock::new();
    CHOSEN.get_or_init(|| {
        let wanted = std::env::var("GONIOD_TARGET").unwrap_or_default();
        let all = || protocols::TARGETS.iter().chain(wires::TARGETS).chain(house::TARGETS).chain(requests::TARGETS);
        all().find(|t| t.name == wanted).unwrap_or_else(|| {
            let names: Vec<&str> = all().map(|t| t.name).collect();
            panic!("GONIOD_TARGET is `{wanted}`; there are: {}", names.join(", "))
        })
    })
}

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    if let Err(promise) = (target().run)(bytes) {
        panic!("{}: {promise}", target().name);
    }
});
