//! Other programs drive the twin: the library's own command line tool, and a GenICam client that shares no code with it
//! (package viva-genicam in `.venv`). A program that is not there is told loudly.

use crate::bench::{alone, twin};
use goniod_sim::gige::GigeTwin;
use std::path::Path;
use std::process::Command;

/// What a program printed, and whether it was content.
struct Said {
    well: bool,
    text: String,
}

fn run(program: &str, arguments: &[&str]) -> Option<Said> {
    match Command::new(program).args(arguments).output() {
        Ok(output) => {
            let text = [output.stdout, output.stderr].map(|s| String::from_utf8_lossy(&s).into_owned()).concat();
            Some(Said { well: output.status.success(), text })
        }
        Err(cause) => {
            println!("*** SKIPPED: {program} cannot be run ({cause}); see tests/setup.sh ***");
            None
        }
    }
}

fn discoverable(serial: &str) -> GigeTwin {
    twin(|c| {
        c.serial = serial.to_owned();
        c.discoverable = true;
        c.real_exposure = true;
    })
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn arv_tool_finds_reads_and_writes_the_twin() {
    let _alone = alone().await;
    let twin = discoverable("SU320-0042");
    let tool = |arguments: &[&str]| run("arv-tool-0.8", arguments).map(|s| s.text);
    let Some(found) = tool(&[]) else { return };
    assert!(found.contains("SU320-0042") && found.contains(&twin.address()), "broadcast discovery: {found}");
    let address = twin.address();
    let control =
        ["-a", &address, "control", "ExposureTime=12345", "ExposureTime", "Gain=3", "Gain", "DeviceSerialNumber"];
    let text = tool(&control).unwrap();
    assert!(text.contains("12345") && text.contains("SU320-0042"), "{text}");
    assert_eq!((twin.exposure_us(), twin.gain_db()), (12_345.0, 3.0));
    let features = tool(&["-a", &address, "features"]).unwrap();
    assert!(features.contains("TriggerSoftware") && features.contains("DeviceTemperature"), "{features}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_client_of_another_house_finds_drives_and_photographs_with_the_twin() {
    let _alone = alone().await;
    let program = concat!(env!("CARGO_MANIFEST_DIR"), "/../.venv/bin/viva-camctl");
    if !Path::new(program).exists() {
        println!("*** SKIPPED: no viva-camctl in .venv; tests/setup.sh python installs it ***");
        return;
    }
    let twin = discoverable("SU320-0043");
    let address = twin.address();
    let tool = |command: &str, rest: &[&str]| {
        run(program, &[&[command, "--ip", &address], rest].concat()).expect("it was there a moment ago")
    };
    let found = tool("list", &[]);
    assert!(found.well && found.text.contains(&address), "discovery: {}", found.text);
    for (feature, value) in [("ExposureTime", "12345"), ("Gain", "3")] {
        assert!(tool("set", &["--name", feature, "--value", value]).well);
        let read = tool("get", &["--name", feature]);
        assert!(read.well && read.text.contains(value), "{feature}: {}", read.text);
    }
    assert_eq!((twin.exposure_us(), twin.gain_db()), (12_345.0, 3.0));
    assert!(!tool("set", &["--name", "ExposureTime", "--value", "1e12"]).well, "the XML tells it the range");
    assert!(tool("get", &["--name", "DeviceSerialNumber"]).text.contains("SU320-0043"));
    let before = twin.traffic().blocks;
    let bench = tool("bench", &["--iface", "127.0.0.1", "--duration-s", "1"]);
    assert!(bench.well, "{}", bench.text);
    assert!(twin.traffic().blocks >= before + 10, "it streamed: {:?}; {}", twin.traffic(), bench.text);
}
