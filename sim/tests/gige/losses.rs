//! Cameras that die, hang, restart, lose control or fall silent: noticed in time, taken up again, nothing mislabelled.

use crate::bench::{alone, open, options, read, settings, snap, twin};
use goniod_drivers::contract::{Camera, Device};
use goniod_drivers::devices::aravis::{AravisCamera, WireFormat};
use goniod_drivers::error::{DeviceError, ErrorKind};
use goniod_sim::gige::{GigeTwin, Reading};
use std::time::Duration;
use tokio::time::Instant;

const EXPOSURE_US: u64 = 200_000;
const READOUT: Duration = Duration::from_millis(50);
/// What a frame may be late: that much later a dead camera is noticed.
const MARGIN: Duration = Duration::from_millis(1_500);

/// A twin whose exposures take their time, and its driver with a good frame behind it.
async fn measuring() -> (GigeTwin, AravisCamera) {
    let twin = twin(|c| (c.real_exposure, c.readout) = (true, Duration::from_millis(5)));
    let mut camera = open(options(&twin, |o| (o.readout, o.margin) = (READOUT, MARGIN))).await;
    let frame = snap(&mut camera, EXPOSURE_US).await.unwrap();
    right(&frame);
    (twin, camera)
}

fn right(frame: &goniod_drivers::frame::Frame) {
    let reading = read(frame, WireFormat::Mono12);
    assert!(matches!(reading, Reading::Whole(tag) if tag.exposure_us == frame.info.settings.exposure.0), "{reading:?}");
}

/// Takes frames until one fails; every frame until then must be what it says. Time from `since` to the failure.
async fn until_noticed(camera: &mut AravisCamera, since: Instant) -> (DeviceError, Duration) {
    loop {
        match snap(camera, EXPOSURE_US).await {
            Ok(frame) => right(&frame),
            Err(error) => return (error, since.elapsed()),
        }
        assert!(since.elapsed() < Duration::from_secs(60), "never noticed");
    }
}

/// Opens until it succeeds and takes a good frame. Time from `since`.
async fn until_measuring(camera: &mut AravisCamera, since: Instant) -> Duration {
    loop {
        let attempt = match camera.open().await {
            Ok(_) => snap(camera, EXPOSURE_US).await,
            Err(error) => Err(error),
        };
        match attempt {
            Ok(frame) => {
                right(&frame);
                return since.elapsed();
            }
            Err(error) => {
                assert!(matches!(error.kind, ErrorKind::Lost | ErrorKind::Timeout), "{error}");
                assert!(since.elapsed() < Duration::from_secs(60), "never back: {error}");
            }
        }
    }
}

fn in_time(what: &str, error: &DeviceError, noticed: Duration, back: Duration) {
    println!("{what}: noticed after {noticed:.2?} ({error}), measuring again {back:.2?} after it was back");
    assert!(matches!(error.kind, ErrorKind::Lost | ErrorKind::Timeout), "{error}");
    assert!(noticed <= Duration::from_micros(EXPOSURE_US) + READOUT + Duration::from_secs(2), "{what}: {noticed:?}");
    assert!(back <= Duration::from_secs(10), "{what}: {back:?}");
}

/// Begins an exposure and lets it run for a while.
async fn mid_exposure(camera: &mut AravisCamera) {
    camera.apply(settings(EXPOSURE_US)).await.unwrap();
    camera.arm().await.unwrap();
    goniod_drivers::clock::Clock::system().sleep(Duration::from_millis(60)).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_camera_without_power_is_noticed_and_taken_up_again() {
    let _alone = alone().await;
    let (mut twin, mut camera) = measuring().await;
    mid_exposure(&mut camera).await;
    let since = Instant::now();
    twin.kill();
    let error = camera.next_frame().await.unwrap_err();
    let noticed = since.elapsed();
    assert_eq!(camera.apply(settings(1_000)).await.unwrap_err().kind, ErrorKind::Lost, "the old handle is void");
    twin.power_up().unwrap();
    let back = until_measuring(&mut camera, Instant::now()).await;
    in_time("killed", &error, noticed, back);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_camera_that_hangs_is_noticed_and_taken_up_again() {
    let _alone = alone().await;
    let (twin, mut camera) = measuring().await;
    mid_exposure(&mut camera).await;
    let since = Instant::now();
    twin.freeze(true);
    let error = camera.next_frame().await.unwrap_err();
    let noticed = since.elapsed();
    goniod_drivers::clock::Clock::system().sleep(Duration::from_secs(4)).await;
    twin.freeze(false);
    let back = until_measuring(&mut camera, Instant::now()).await;
    in_time("frozen", &error, noticed, back);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_quick_restart_with_power_up_features_never_mislabels() {
    let _alone = alone().await;
    for lax_access in [false, true] {
        let (mut twin, mut camera) = measuring().await;
        twin.faults(|f| f.lax_access = lax_access);
        let since = Instant::now();
        twin.kill();
        twin.power_up().unwrap();
        assert_eq!(twin.exposure_us(), 10_000.0, "power-up features");
        let (error, noticed) = until_noticed(&mut camera, since).await;
        let back = until_measuring(&mut camera, since).await;
        in_time(if lax_access { "restarted, lax access" } else { "restarted" }, &error, noticed, back);
        assert_eq!(twin.exposure_us(), EXPOSURE_US as f64, "all features written again");
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn control_dropped_in_mid_exposure_is_noticed() {
    let _alone = alone().await;
    let (twin, mut camera) = measuring().await;
    mid_exposure(&mut camera).await;
    let since = Instant::now();
    twin.drop_control();
    let error = camera.next_frame().await.unwrap_err();
    let noticed = since.elapsed();
    let back = until_measuring(&mut camera, Instant::now()).await;
    in_time("control dropped", &error, noticed, back);
    assert_eq!(error.kind, ErrorKind::Lost, "the heartbeat tells before the frame is missed: {error}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_mute_camera_times_out_with_the_likely_cause() {
    let _alone = alone().await;
    let (twin, mut camera) = measuring().await;
    twin.faults(|f| f.mute = true);
    let error = snap(&mut camera, EXPOSURE_US).await.unwrap_err();
    assert_eq!(error.kind, ErrorKind::Timeout);
    assert!(error.message.contains("firewall"), "{error}");
    twin.faults(|f| f.mute = false);
    until_measuring(&mut camera, Instant::now()).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_deaf_camera_fails_the_command_and_is_taken_up_again() {
    let _alone = alone().await;
    let (twin, mut camera) = measuring().await;
    twin.faults(|f| f.deaf = true);
    let since = Instant::now();
    let error = camera.apply(settings(1_000)).await.unwrap_err();
    assert_eq!(error.kind, ErrorKind::Timeout, "{error}");
    assert!(since.elapsed() < Duration::from_millis(3_500), "{:?}", since.elapsed());
    assert_eq!(camera.arm().await.unwrap_err().kind, ErrorKind::Lost, "the old handle is void");
    twin.faults(|f| f.deaf = false);
    let back = until_measuring(&mut camera, Instant::now()).await;
    assert!(back <= Duration::from_secs(10), "{back:?}");
}

/// A call that the library does not come back from is left to itself; the next opening works beside it.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_stuck_call_is_abandoned_and_replaced() {
    let _alone = alone().await;
    let (twin, mut camera) = measuring().await;
    twin.faults(|f| f.slow_answer = Some(Duration::from_millis(1_200)));
    let since = Instant::now();
    let error = snap(&mut camera, 1_000).await.unwrap_err();
    assert_eq!(error.kind, ErrorKind::Timeout, "{error}");
    assert!(since.elapsed() < Duration::from_secs(7), "{:?}", since.elapsed());
    twin.faults(|f| f.slow_answer = None);
    let back = until_measuring(&mut camera, Instant::now()).await;
    assert!(back <= Duration::from_secs(10), "{back:?}");
    println!("abandoned: {error}; measuring again after {back:.2?}, {} threads", camera.threads());
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_camera_that_is_not_there_is_named_with_what_to_check() {
    let _alone = alone().await;
    let mut twin = twin(|_| {});
    let mut camera = AravisCamera::new(options(&twin, |o| o.margin = MARGIN), goniod_drivers::clock::Clock::system());
    twin.kill();
    let error = camera.open().await.unwrap_err();
    assert_eq!(error.kind, ErrorKind::Lost);
    assert!(error.message.contains("check power") && error.device.contains(&twin.address()), "{error}");
}
