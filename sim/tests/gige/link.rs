//! Opening, features, formats, access rules, health.

use crate::bench::{alone, open, options, read, sensor, settings, snap, twin};
use goniod_drivers::clock::Clock;
use goniod_drivers::contract::{Camera, Device};
use goniod_drivers::devices::aravis::{AravisCamera, Cooler, Trigger, WireFormat};
use goniod_drivers::error::ErrorKind;
use goniod_drivers::units::ExposureTime;
use goniod_sim::gige::{PixelCode, Reading, address};
use std::time::Duration;

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn it_knows_the_camera_and_refuses_another_one() {
    let _alone = alone().await;
    let twin = twin(|_| {});
    let mut camera = open(options(&twin, |_| {})).await;
    let info = camera.info().clone();
    assert_eq!((info.identity.model.as_str(), info.identity.serial.as_str()), ("GigeTwin", "SU320-0042"));
    assert_eq!((info.width, info.height), (320, 256));
    assert_eq!((info.shortest, info.longest), (ExposureTime(20), ExposureTime(120_000_000)));
    camera.make_safe().await.unwrap();
    drop(camera);
    let mut other = AravisCamera::new(options(&twin, |o| o.serial = "SU320-0001".into()), Clock::system());
    let error = other.open().await.unwrap_err();
    assert_eq!(error.kind, ErrorKind::WrongDevice);
    assert!(error.message.contains("SU320-0042") && error.message.contains("SU320-0001"), "{error}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn every_pixel_format_arrives_level_by_level() {
    let _alone = alone().await;
    for format in WireFormat::ALL {
        let twin = twin(|c| c.sensor = sensor(320, 256, PixelCode::Mono8));
        let mut camera = open(options(&twin, |o| o.format = format)).await;
        for exposure_us in [100, 40_000_000] {
            let frame = snap(&mut camera, exposure_us).await.unwrap();
            let reading = read(&frame, format);
            assert!(
                matches!(reading, Reading::Whole(tag) if tag.exposure_us == exposure_us),
                "{format:?}: {reading:?}"
            );
            assert_eq!(frame.info.format, format.frame_format());
        }
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_value_out_of_range_is_refused_and_the_camera_goes_on() {
    let _alone = alone().await;
    let twin = twin(|_| {});
    let mut camera = open(options(&twin, |_| {})).await;
    let error = camera.apply(settings(1_000_000_000_000)).await.unwrap_err();
    assert_eq!(error.kind, ErrorKind::Refused, "{error}");
    assert!(snap(&mut camera, 5_000).await.is_ok());
    twin.faults(|f| f.wrong_readback = Some(1.5));
    let error = camera.apply(settings(7_000)).await.unwrap_err();
    assert_eq!(error.kind, ErrorKind::Broken, "{error}");
    assert!(error.message.contains("reads back"), "{error}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_camera_held_by_another_program_is_lost_not_read_only() {
    let _alone = alone().await;
    let twin = twin(|_| {});
    let first = open(options(&twin, |_| {})).await;
    let mut second = AravisCamera::new(options(&twin, |_| {}), Clock::system());
    let error = second.open().await.unwrap_err();
    assert_eq!(error.kind, ErrorKind::Lost);
    assert!(error.message.contains("another program"), "{error}");
    drop(first);
    second.open().await.expect("free once the other has closed it");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn temperature_and_cooler_are_health_readings() {
    let _alone = alone().await;
    let twin = twin(|_| {});
    let cooler = Cooler { feature: "SensorCoolerState".into(), good: "Locked".into() };
    let mut camera = open(options(&twin, |o| o.cooler = Some(cooler))).await;
    let health = camera.health().await.unwrap();
    assert_eq!(health.temperature_c, Some(-12.5));
    assert!(health.warnings.iter().all(|w| !w.contains("cooler")), "{health:?}");
    twin.set_register(address::COOLER, 1);
    let health = camera.health().await.unwrap();
    assert!(health.warnings.iter().any(|w| w.contains("cooler is Settling")), "{health:?}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn short_frames_are_counted_and_their_pixels_never_seen() {
    let _alone = alone().await;
    let twin = twin(|_| {});
    let mut camera = open(options(&twin, |_| {})).await;
    twin.faults(|f| f.short_per_1000 = 1000);
    camera.apply(settings(5_000)).await.unwrap();
    camera.arm().await.unwrap();
    let frame = camera.next_frame().await.unwrap();
    assert!(frame.info.damaged && frame.pixels.is_empty());
    assert_eq!(camera.counts().incomplete, 1);
    twin.faults(|f| f.short_per_1000 = 0);
    let frame = snap(&mut camera, 5_000).await.unwrap();
    assert!(matches!(read(&frame, WireFormat::Mono12), Reading::Whole(_)));
}

/// An exposure under way when settings change must not come out as one of the new ones.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn arming_anew_in_mid_exposure_gives_the_new_exposure_only() {
    let _alone = alone().await;
    for trigger in [Trigger::Software, Trigger::FreeRun { frame_rate_hz: 20.0 }] {
        let twin = twin(|c| c.real_exposure = true);
        let mut camera = open(options(&twin, |o| o.trigger = trigger)).await;
        camera.apply(settings(150_000)).await.unwrap();
        camera.arm().await.unwrap();
        Clock::system().sleep(Duration::from_millis(40)).await;
        camera.apply(settings(20_000)).await.unwrap();
        let armed = camera.arm().await.unwrap();
        let frame = loop {
            let frame = camera.next_frame().await.unwrap();
            if frame.info.exposure_start >= armed.not_before {
                break frame;
            }
            assert!(trigger != Trigger::Software, "with a trigger nothing old may come");
        };
        assert!(matches!(read(&frame, WireFormat::Mono12), Reading::Whole(tag) if tag.exposure_us == 20_000));
        camera.stop().await.unwrap();
        let frame = snap(&mut camera, 30_000).await.unwrap();
        assert!(matches!(read(&frame, WireFormat::Mono12), Reading::Whole(_)), "it streams again after a stop");
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn giving_up_waiting_loses_no_frame_and_triggers_no_second_one() {
    let _alone = alone().await;
    let twin = twin(|c| c.real_exposure = true);
    let mut camera = open(options(&twin, |_| {})).await;
    camera.apply(settings(150_000)).await.unwrap();
    camera.arm().await.unwrap();
    let first = camera.next_frame().await.unwrap();
    let clock = Clock::system();
    assert!(clock.timeout(Duration::from_millis(30), camera.next_frame()).await.is_err(), "still exposing");
    let second = camera.next_frame().await.unwrap();
    assert_eq!(second.info.device_frame_id, first.info.device_frame_id + 1);
    assert_eq!(twin.traffic().blocks, 2);
    let gap = second.info.exposure_start - first.info.exposure_start;
    assert!(gap >= Duration::from_millis(150), "exposures follow one another on the host's clock: {gap:?}");
}
