//! Formats, automatic functions, read-back, frame interval, sums: what the driver makes of a camera's tempers.

use crate::bench::{Bench, config, label_is_true, node, settings, truth};
use crate::shim::paint::level;
use crate::shim::twin::{AUTOGAIN, EXPOSURE_ABSOLUTE, EXPOSURE_AUTO, GAIN, GAMMA, Plan};
use goniod_drivers::clock::Clock;
use goniod_drivers::contract::{Camera, Device};
use goniod_drivers::devices::v4l2::V4l2Config;
use goniod_drivers::error::{DeviceError, ErrorKind};
use goniod_drivers::frame::{BayerOrder, PixelFormat, Pixels};
use goniod_drivers::units::ExposureTime;

async fn refusal(plan: Plan, config: V4l2Config) -> DeviceError {
    Bench::closed(plan, config).camera.open().await.expect_err("must not open")
}

#[tokio::test]
async fn automatic_functions_go_off_first_and_fixed_controls_are_proven() {
    let wish = V4l2Config { fixed: vec![(GAMMA, 100)], ..config("settings-auto") };
    let mut bench = Bench::open(Plan::default(), wish).await;
    let value = |id| bench.twin().controls[&id].value;
    assert_eq!([EXPOSURE_AUTO, AUTOGAIN, GAMMA].map(value), [1, 0, 100]);
    let got = bench.acquire(settings(81, 7.0)).await;
    assert!(label_is_true(&got), "{:?}", truth(&got));
    assert_eq!(bench.camera.info().identity.serial, "SN42");
}

#[tokio::test]
async fn automatic_functions_switched_on_by_another_program_are_switched_off_at_the_next_setting() {
    let mut bench = Bench::open(Plan::default(), config("settings-meddler")).await;
    bench.acquire(settings(81, 7.0)).await;
    bench.twin().set(AUTOGAIN, 1);
    assert!(label_is_true(&bench.acquire(settings(27, 3.0)).await));
    bench.twin().set(EXPOSURE_ABSOLUTE, 99);
    let error = bench.camera.arm().await.unwrap_err();
    assert_eq!(error.kind, ErrorKind::Broken);
    assert!(error.message.contains("changed by themselves"), "{error}");
}

#[tokio::test]
async fn a_control_that_reads_back_differently_is_never_taken_for_set() {
    let plan = Plan { stubborn: Some(GAMMA), ..Plan::default() };
    let wish = V4l2Config { fixed: vec![(GAMMA, 100)], ..config("settings-stubborn") };
    let error = refusal(plan, wish).await;
    assert_eq!(error.kind, ErrorKind::Broken);
    assert!(error.message.contains("was set to 100 and reads 200"), "{error}");

    let plan = Plan { stubborn: Some(GAIN), ..Plan::default() };
    let mut bench = Bench::open(plan, config("settings-stubborn-gain")).await;
    let applied = bench.camera.apply(settings(81, 5.0)).await.unwrap();
    assert_eq!(applied.gain, 8.0, "what the camera really has");
    let error = bench.camera.apply(settings(81, 500.0)).await.unwrap_err();
    assert_eq!(error.kind, ErrorKind::Refused);
    assert!(error.message.contains("a gain of 500 is outside the camera's 0 to 63"), "{error}");
}

#[tokio::test]
async fn the_interval_makes_room_for_a_longer_exposure_also_when_it_cannot_change_while_streaming() {
    for (name, interval_busy, forgets_at_start) in
        [("settings-interval", false, false), ("settings-busy", true, false), ("settings-forgets", true, true)]
    {
        let plan = Plan { interval_busy, forgets_at_start, ..Plan::default() };
        let mut bench = Bench::open(plan, config(name)).await;
        for raw in [10, 50_000, 10, 99_000, 5_000] {
            assert!(label_is_true(&bench.acquire(settings(raw, 2.0)).await), "{name}: {raw}");
        }
        assert!(bench.twin().sensor.interval_ns < 1_000_000_000, "the interval came down again");
    }
}

#[tokio::test]
async fn an_exposure_that_the_camera_cuts_is_reported_as_cut() {
    let plan = Plan { interval_ns: (40_000_000, 1_000_000_000), ..Plan::default() };
    let mut bench = Bench::open(plan, config("settings-cut")).await;
    let applied = bench.camera.apply(settings(50_000, 1.0)).await.unwrap();
    assert_eq!(applied.exposure, ExposureTime(1_000_000));
}

#[tokio::test]
async fn exposures_beyond_the_limit_are_sums_with_their_count_or_refused() {
    let mut bench = Bench::open(Plan::default(), config("settings-long")).await;
    let error = bench.camera.apply(settings(300_000, 1.0)).await.unwrap_err();
    assert_eq!(error.kind, ErrorKind::Refused);
    assert!(error.message.contains("an exposure of 30 s is longer than the 10 s"), "{error}");

    let plan = Plan { latency: (0, 5), fault_every: 6, interval_ns: (40_000_000, 6_000_000_000), ..Plan::default() };
    let wish = V4l2Config { sum_limit: 12, longest_s: 5.0, ..config("settings-sum") };
    let mut bench = Bench::open(plan, wish).await;
    let got = bench.acquire(settings(300_000, 1.0)).await;
    let info = &got.info;
    assert_eq!(info.format, PixelFormat::Summed { mosaic: Some(BayerOrder::Rggb), bits: 8, exposures: 6 });
    assert_eq!((info.settings.exposure, info.format.levels()), (ExposureTime(30_000_000), 256 * 6));
    assert!(info.received - info.exposure_start >= std::time::Duration::from_secs(30));
    let Pixels::U16(sums) = &got.pixels else { panic!("sums are words") };
    assert_eq!(bench.camera.info().format, info.format, "the camera says what its frames are now");
    let below = &sums[64..];
    let (low, high) = (6 * u16::from(level(50_000)), 6 * u16::from(level(50_000)) + 6);
    assert!(below.iter().all(|p| (low..=high).contains(p)), "six frames of 5 s each: {low} to {high}");
    assert!(below.iter().any(|p| *p != low), "six different pictures");
}

#[tokio::test]
async fn lines_longer_than_their_pixels_are_unpadded_for_each_kind_of_format() {
    let kinds = [
        (*b"RGGB", PixelFormat::BayerRggb8),
        (*b"RG12", PixelFormat::BayerRggb12),
        (*b"GREY", PixelFormat::Mono8),
        (*b"Y16 ", PixelFormat::Mono16),
    ];
    for (i, (code, format)) in kinds.into_iter().enumerate() {
        let name = format!("settings-format-{i}");
        let plan = Plan { formats: vec![*b"MJPG", code], padding: 32, ..Plan::default() };
        let mut bench = Bench::open(plan, config(&name)).await;
        let got = bench.acquire(settings(81, 7.0)).await;
        assert_eq!((got.info.format, got.pixels.len()), (format, 64 * 48));
        assert!(label_is_true(&got), "{name}");
        let base = u16::from(level(81));
        assert!((64..64 * 48).all(|p| [base, base + 1].contains(&got.pixels.level(p))), "{name}");
    }
}

/// The sensor of the paper at its full size, with a gamma that the bridge admits to.
#[tokio::test]
async fn a_full_sensor_passes_and_a_gamma_in_the_chain_is_said() {
    let plan = Plan { size: (1392, 1040), transfer: 2, ..Plan::default() };
    let wish = V4l2Config { width: 1392, height: 1040, ..config("settings-full-size") };
    let mut bench = Bench::open(plan, wish).await;
    let got = bench.acquire(settings(81, 7.0)).await;
    assert_eq!(got.pixels.len(), 1392 * 1040);
    assert!(label_is_true(&got));
    let health = bench.camera.health().await.unwrap();
    assert!(health.warnings.iter().any(|w| w.contains("not linear")), "{health:?}");
}

#[tokio::test]
async fn yuyv_works_with_its_warning() {
    let plan = Plan { formats: vec![*b"YUYV"], ..Plan::default() };
    let mut bench = Bench::open(plan, config("settings-yuyv")).await;
    let got = bench.acquire(settings(81, 7.0)).await;
    assert_eq!((got.info.format, got.pixels.len()), (PixelFormat::Yuyv8, 2 * 64 * 48));
    assert!(got.info.format.caution().is_some());
    let health = bench.camera.health().await.unwrap();
    assert!(health.warnings.iter().any(|w| w.starts_with("YUYV")), "{health:?}");
}

#[tokio::test]
async fn what_cannot_be_measured_with_is_refused_in_a_sentence() {
    let base = Plan::default();
    let cases = [
        ("settings-size", Plan { size: (32, 48), ..base.clone() }, config("settings-size"), "makes 32 x 48"),
        ("settings-none", Plan { formats: vec![*b"MJPG"], ..base.clone() }, config("settings-none"), "offers MJPG"),
        ("settings-field", Plan { field: 4, ..base.clone() }, config("settings-field"), "interlaced"),
        (
            "settings-card",
            base.clone(),
            V4l2Config { card: "Other".into(), ..config("settings-card") },
            "expected \"Other\"",
        ),
        ("settings-serial", base, V4l2Config { serial: "SN43".into(), ..config("settings-serial") }, "SN43"),
    ];
    for (name, plan, wish, sentence) in cases {
        let error = refusal(plan, wish).await;
        assert!(matches!(error.kind, ErrorKind::Refused | ErrorKind::WrongDevice), "{name}: {error}");
        assert!(error.message.contains(sentence), "{name}: {error}");
    }
    let error = V4l2Config { node: node("nowhere").into(), ..config("settings-nowhere") };
    let error = goniod_drivers::devices::v4l2::V4l2Camera::new(error, Clock::system()).open().await.unwrap_err();
    assert_eq!(error.kind, ErrorKind::Lost);
}
