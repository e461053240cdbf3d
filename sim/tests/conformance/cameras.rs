//! Cameras: the safe checks on the GigE twin; what a wire may do to frames has tests of its own, which are named.

use goniod_drivers::conformance::{Finding, SAFE, Verdict};
use goniod_sim::conformance::noise::Counts;
use goniod_sim::conformance::{Conduct, checks};

/// Tests that hold the promises for cameras: check, then file and test of each driver. Empty: it speaks of byte lines.
const ELSEWHERE: [(&str, [&str; 2], [&str; 2]); 14] = [
    (
        "another device",
        ["settings.rs", "what_cannot_be_measured_with_is_refused_in_a_sentence"],
        ["link.rs", "it_knows_the_camera_and_refuses_another_one"],
    ),
    ("before opening", ["faults.rs", "nothing_is_armed_or_taken_from_a_camera_without_settings"], ["", ""]),
    (
        "nothing sent",
        ["settings.rs", "exposures_beyond_the_limit_are_sums_with_their_count_or_refused"],
        ["link.rs", "a_value_out_of_range_is_refused_and_the_camera_goes_on"],
    ),
    ("power-up", ["faults.rs", UNPLUGGED], ["losses.rs", RESTARTED]),
    (
        "busy",
        ["labels.rs", "an_arming_without_new_settings_waits_for_a_frame_that_starts_later"],
        ["link.rs", "arming_anew_in_mid_exposure_gives_the_new_exposure_only"],
    ),
    (
        "silence",
        ["faults.rs", "a_stream_that_stands_is_a_timeout_with_its_time"],
        ["losses.rs", "a_mute_camera_times_out_with_the_likely_cause"],
    ),
    ("late", ["labels.rs", SWEPT], ["labels.rs", LABELS]),
    ("lost", ["labels.rs", SWEPT], ["streaming.rs", "five_packets_lost_of_a_thousand_are_all_recovered"]),
    ("cut", ["labels.rs", SWEPT], ["link.rs", "short_frames_are_counted_and_their_pixels_never_seen"]),
    ("doubled", ["labels.rs", SWEPT], ["labels.rs", LABELS]),
    ("previous", ["labels.rs", SWEPT], ["labels.rs", LABELS]),
    ("restart", ["faults.rs", UNPLUGGED], ["losses.rs", RESTARTED]),
    ("unplug", ["faults.rs", UNPLUGGED], ["losses.rs", "a_camera_without_power_is_noticed_and_taken_up_again"]),
    ("noise", ["labels.rs", SWEPT], ["labels.rs", LABELS]),
];
const UNPLUGGED: &str = "an_unplugged_camera_is_lost_until_opened_and_everything_is_proven_again";
const RESTARTED: &str = "a_quick_restart_with_power_up_features_never_mislabels";
const SWEPT: &str = "swept_brackets_never_carry_a_wrong_label";
const LABELS: &str = "no_label_is_wrong_with_a_software_trigger";
/// Folders of those files.
const FOLDERS: [&str; 2] = ["drivers/tests/v4l2", "sim/tests/gige"];

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
        let [file, test] = held.map_or(["", ""], |(_, shim, gige)| if v4l2 { *shim } else { *gige });
        let why = match file {
            "" if SAFE.contains(&check) => "held by drivers/tests/v4l2/conformance.rs, where the shim is".to_owned(),
            "" => "speaks of a byte line; frames are judged one by one (docs/cameras.md)".to_owned(),
            file => format!("held by {}/{file}, `{test}`", FOLDERS[usize::from(!v4l2)]),
        };
        Finding { check, verdict: Verdict::NotApplicable(why) }
    });
    Conduct { driver, findings: safe.iter().cloned().chain(rest).collect(), noise: Counts::default() }
}

#[test]
fn the_tests_named_for_cameras_exist() {
    let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    for (check, shim, gige) in ELSEWHERE {
        for (folder, [file, test]) in FOLDERS.into_iter().zip([shim, gige]).filter(|(_, [file, _])| !file.is_empty()) {
            let text = std::fs::read_to_string(root.join(folder).join(file)).unwrap();
            assert!(text.contains(&format!("fn {test}()")), "{check}: {folder}/{file} has no test {test}");
        }
    }
    assert!(root.join("drivers/tests/v4l2/conformance.rs").exists());
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
