//! Cameras: the safe checks on the GigE twin; what a wire may do to frames has tests of its own, which are named.

use goniod_drivers::conformance::{Finding, SAFE, Verdict};
use goniod_sim::conformance::noise::Counts;
use goniod_sim::conformance::{Conduct, checks};

/// Where each promise about a camera is held, by check; the rest speaks of byte lines.
const ELSEWHERE: [(&str, &str, &str); 9] = [
    ("another device", "drivers/tests/v4l2/settings.rs", "sim/tests/gige/link.rs"),
    ("power-up", "drivers/tests/v4l2/settings.rs", "sim/tests/gige/labels.rs"),
    ("silence", "drivers/tests/v4l2/faults.rs", "sim/tests/gige/link.rs"),
    ("late", "drivers/tests/v4l2/labels.rs", "sim/tests/gige/labels.rs"),
    ("lost", "drivers/tests/v4l2/faults.rs", "sim/tests/gige/losses.rs"),
    ("doubled", "drivers/tests/v4l2/labels.rs", "sim/tests/gige/labels.rs"),
    ("previous", "drivers/tests/v4l2/labels.rs", "sim/tests/gige/labels.rs"),
    ("unplug", "drivers/tests/v4l2/faults.rs", "sim/tests/gige/link.rs"),
    ("noise", "drivers/tests/v4l2/labels.rs", "sim/tests/gige/losses.rs"),
];

/// The cameras' columns of the page.
pub fn conducts() -> Vec<Conduct> {
    let mut all = vec![camera("v4l2", &[])];
    #[cfg(feature = "aravis")]
    all.push(camera("aravis", &gige::safe()));
    all
}

/// Findings of the safe checks, then where the rest is held.
fn camera(driver: &'static str, safe: &[Finding]) -> Conduct {
    let v4l2 = driver == "v4l2";
    let rest = checks().into_iter().skip(safe.len()).map(|check| {
        let held = ELSEWHERE.iter().find(|(name, ..)| *name == check.name);
        let why = match held {
            Some((_, shim, gige)) => format!("held by {}", if v4l2 { shim } else { gige }),
            None if SAFE.contains(&check) => "held by drivers/tests/v4l2/conformance.rs, where the shim is".to_owned(),
            None => "speaks of a byte line; frames are judged one by one (docs/cameras.md)".to_owned(),
        };
        Finding { check, verdict: Verdict::NotApplicable(why) }
    });
    Conduct { driver, findings: safe.iter().cloned().chain(rest).collect(), noise: Counts::default() }
}

#[test]
fn the_files_named_for_cameras_exist() {
    let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let named = ELSEWHERE.iter().flat_map(|(_, a, b)| [*a, *b]).chain(["drivers/tests/v4l2/conformance.rs"]);
    for file in named {
        assert!(root.join(file).exists(), "{file}");
    }
}

#[cfg(feature = "aravis")]
mod gige {
    use goniod_drivers::clock::Clock;
    use goniod_drivers::conformance::{Finding, Subject, check};
    use goniod_drivers::devices::aravis::{AravisCamera, AravisOptions};
    use goniod_sim::gige::{GigeTwin, Painted, TwinConfig};
    use std::net::Ipv4Addr;
    use std::sync::Arc;

    /// The safe checks in real time over loopback UDP.
    pub fn safe() -> Vec<Finding> {
        let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build().unwrap();
        runtime.block_on(async {
            let [.., high, low] = std::process::id().to_be_bytes();
            let address = Ipv4Addr::new(127, 1 + high % 250, low, 251);
            let config = TwinConfig::quick(address, "SU320-0042");
            let twin = GigeTwin::start(config, Arc::new(Painted)).expect("the loopback address is free");
            let options = AravisOptions::new("camera.ingaas", &twin.address(), "SU320-0042");
            let mut subject = Subject::Camera(Box::new(AravisCamera::new(options, Clock::system())));
            let findings = check(&mut subject, Clock::system(), &mut |_| ()).await;
            let failed: Vec<&Finding> = findings.iter().filter(|finding| finding.verdict.failed()).collect();
            assert!(failed.is_empty(), "{failed:#?}");
            findings
        })
    }
}
