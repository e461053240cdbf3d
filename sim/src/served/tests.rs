//! The side channel's words, and a bench that is served, asked, spoilt and put away.
#![allow(clippy::unwrap_used, clippy::expect_used)]

use super::*;
use crate::faults::catalogue::{CameraKind, Kind, LineKind};
use crate::twins::TwinsSpec;
use goniod_drivers::frame::PixelFormat;
use goniod_drivers::transport::{Connector, SerialConnector};
use serde_json::Value;
use std::io::{BufRead, BufReader, Write};
use std::os::unix::net::UnixStream;
use std::time::Duration;

fn config(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap().join("config/sim").join(name)
}

fn site(folder: &Path) -> Site {
    let ingaas = CameraConfig {
        serial: "INGAAS-0001".into(),
        width: 320,
        height: 256,
        format: PixelFormat::Mono12,
        shortest_s: 1e-6,
        longest_s: 120.0,
        readout_s: 0.01,
        name: "camera.ingaas".into(),
        port: String::new(),
        frame_interval_s: 0.0,
        discard_frames: 0,
        v4l2: None,
        aravis: None,
    };
    Site {
        folder: folder.to_owned(),
        lines: vec![Line::Holder, Line::FilterWheel, Line::Shutter, Line::LightMonitor, Line::Monochromator],
        cameras: BTreeMap::from([("ingaas".to_owned(), ingaas)]),
        meter: None,
        spectrometer: Some(UsbSite { product: 0x101e, serial: "USB2+H00001".into() }),
        seed: 7,
    }
}

fn start(site: &Site) -> Result<Served, ServeError> {
    let drivers = ["zaber-ascii", "thorlabs-fw212c", "thorlabs-sc10"];
    let twins = Twins::new(TwinsSpec::with_serials("1", "2", "3").with_drivers(drivers).unwrap());
    let clock = Clock::system();
    let bench =
        Bench::open(&config("bench.toml"), &config("samples/clear_glazing.toml"), 7, Arc::new(twins.clone()), clock)?;
    twins.look_at(bench.lamp());
    Served::start(site, twins, &bench, clock)
}

/// One line over the socket.
async fn ask(folder: &Path, line: &str) -> Value {
    let (path, line) = (folder.join(SOCKET), line.to_owned());
    tokio::task::spawn_blocking(move || {
        let mut stream = UnixStream::connect(path).unwrap();
        stream.write_all(format!("{line}\n").as_bytes()).unwrap();
        let mut reply = String::new();
        BufReader::new(stream).read_line(&mut reply).unwrap();
        serde_json::from_str(&reply).unwrap()
    })
    .await
    .unwrap()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_served_bench_is_found_by_its_names_and_tells_its_truth() {
    let folder = tempfile::tempdir().unwrap();
    let served = start(&site(folder.path())).unwrap();
    for name in ["holder", "filter-wheel", "shutter", "light-monitor", "monochromator", SOCKET] {
        assert!(folder.path().join(name).symlink_metadata().is_ok(), "{name}");
    }
    let pose = ask(folder.path(), "pose").await;
    assert_eq!((&pose["ok"]["shutter_open"], &pose["ok"]["slot"]), (&false.into(), &3.into()), "{pose}");

    // Another program moves the wheel; a fault ordered before meets the answer that follows.
    let clock = Clock::system();
    let path = folder.path().join("filter-wheel");
    let mut link = SerialConnector::new(path.to_str().unwrap(), 115_200, clock).connect().await.unwrap();
    link.send(b"pos=5\r").await.unwrap();
    link.prompt(clock.now() + Duration::from_secs(20)).await.unwrap();
    assert_eq!(ask(folder.path(), "pose").await["ok"]["slot"], 5);
    assert_eq!(ask(folder.path(), "wheel silence").await["ok"]["done"], "wheel silence");
    assert_eq!(ask(folder.path(), "counters").await["ok"]["waiting"][0], "filter_wheel");
    link.send(b"pos?\r").await.unwrap();
    let answer = link.prompt(clock.now() + Duration::from_millis(500)).await;
    assert!(!matches!(answer, Ok(Some(_))), "{answer:?}");
    let counters = ask(folder.path(), "counters").await;
    assert_eq!(counters["ok"]["waiting"].as_array().unwrap().len(), 0, "{counters}");
    assert_eq!(counters["ok"]["asked"]["wheel silence"], 1);

    let hints = served.usb_hints();
    let told = |hint: &str| hint.contains("attach -r 127.0.0.1 -b 1-2") || hint.contains("is plugged into");
    assert!(hints.len() == 1 && told(&hints[0]), "{hints:?}");
    drop(served);
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0, "nothing is left behind");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn two_benches_stand_beside_each_other_but_not_in_one_folder() {
    let (one, two) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let first = start(&site(one.path())).unwrap();
    assert!(matches!(start(&site(one.path())), Err(ServeError::InUse { .. })));
    let second = start(&site(two.path())).unwrap();
    assert_ne!(first.addresses()["ingaas"], second.addresses()["ingaas"]);
    let address = first.addresses().clone();
    drop(first);
    let again = start(&site(one.path())).unwrap();
    assert_eq!(again.addresses(), &address, "a bench that is started again is where it was");
    assert_eq!(ask(two.path(), "lamp off").await["ok"]["done"], "lamp off");
    assert_eq!(ask(two.path(), "pose").await["ok"]["lamp_burns"], false);
    assert_eq!(ask(one.path(), "pose").await["ok"]["lamp_burns"], true, "each has a lamp of its own");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn every_fault_of_the_catalogue_has_a_word_and_bad_lines_get_a_sentence() {
    let folder = tempfile::tempdir().unwrap();
    let served = start(&site(folder.path())).unwrap();
    let listed = served.board().carry_out("faults").unwrap();
    // A pseudo-terminal cannot make the program that opens it wait; a GigE camera that does not take a setting has
    // its own word, `wrong-readback`.
    let elsewhere = |kind: &Kind| {
        let untaken = Kind::Camera(CameraKind::NotTaken);
        matches!(kind, Kind::Operator(_) | Kind::Line(_, LineKind::Stuck)) || *kind == untaken
    };
    for kind in Kind::all().into_iter().filter(|kind| !elsewhere(kind)) {
        let text = kind.to_string();
        let (part, word) = text.split_once(": ").unwrap();
        let part = match part.trim_end_matches(" line") {
            "wheel" => "filter_wheel",
            "camera" => "ingaas",
            other => other,
        };
        assert!(listed[part].get(word.replace(' ', "-")).is_some(), "{text}: {}", listed[part]);
    }
    for (line, words) in [
        ("", "the line is empty"),
        ("hodler cut", "the bench has no `hodler`; it has `holder`"),
        ("ccd black", "`ingaas`"),
        ("holder", "`holder` needs a fault: `busy`"),
        ("holder explode", "no fault `explode`; it has `busy`"),
        ("holder cut often", "`often` is not a number"),
        ("holder cut NaN", "`NaN` is not a number"),
        ("holder stall", "it needs a number: degrees"),
        ("holder restart 3", "it takes no number"),
        ("holder silence 0", "write a number from 1 to 1000"),
        ("shutter stuck -1", "write a number from 0 to 86400"),
        ("holder cut 3 4", "too many words"),
        ("pose now", "stands alone"),
    ] {
        let answer = ask(folder.path(), line).await;
        assert!(answer["error"].as_str().is_some_and(|e| e.contains(words)), "{line}: {answer}");
    }
    let long = "x".repeat(5000);
    assert!(ask(folder.path(), &long).await["error"].as_str().unwrap().contains("1024 bytes"));
    for (part, fault) in listed.as_object().unwrap() {
        for word in fault.as_object().unwrap().keys().filter(|word| !word.starts_with("unplugged")) {
            let line = if word == "stall" && part != "spectrometer" {
                format!("{part} {word} 30")
            } else {
                format!("{part} {word}")
            };
            let answer = served.board().carry_out(&line);
            assert!(answer.is_ok(), "{line}: {answer:?}");
        }
    }
}

/// A camera of the bench that the instrument describes otherwise is refused, and nothing is left behind.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_camera_that_does_not_fit_is_refused_with_what_does() {
    let folder = tempfile::tempdir().unwrap();
    let with = |change: fn(&mut CameraConfig)| {
        let mut site = site(folder.path());
        site.cameras.values_mut().for_each(change);
        start(&site).err().unwrap().to_string()
    };
    assert!(with(|c| c.width = 640).contains("photographs 320 x 256"));
    assert!(with(|c| c.serial = "A-VERY-LONG-SERIAL-NUMBER".into()).contains("at most 15 bytes"));
    assert!(with(|c| c.format = PixelFormat::Yuyv8).contains("has no format Yuyv8"));
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
}
