//! The simulated cameras as devices: latency, painted truth, faults, refusals.
#![allow(clippy::unwrap_used, clippy::expect_used)]

use super::*;
use crate::bench::Bench;
use crate::oracle::{OracleError, read_pixels};
use crate::pose::PoseSource;
use crate::truth::config::BenchFile;
use goniod_drivers::clock::{Clock, UtcMicros};
use goniod_drivers::units::ExposureTime;

/// Spin turns at 1 degree a second from `moves_from` on; everything else stands.
struct Poses {
    moves_from: Instant,
}

impl PoseSource for Poses {
    fn pose(&self, at: Instant) -> Pose {
        let moved = at.checked_duration_since(self.moves_from).unwrap_or_default();
        let spin_deg = 30.0 + moved.as_secs_f64();
        Pose { tilt_deg: 150.0, spin_deg, changer_deg: 0.0, slot: Some(9), shutter_open: true }
    }
}

/// A file of the shipped bench.
fn path(name: &str) -> std::path::PathBuf {
    std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../config/sim").join(name)
}

fn bench(seed: u64) -> Bench {
    bench_of(seed, BenchFile::read(&path("bench.toml")).unwrap())
}

fn bench_of(seed: u64, file: BenchFile) -> Bench {
    let clock = Clock::starting_at(UtcMicros(1_800_000_000_000_000));
    let poses = Arc::new(Poses { moves_from: clock.now() + Duration::from_secs(3600) });
    Bench::assemble(file, &path("bench.toml"), &path("samples/lambertian_t20.toml"), seed, poses, clock).unwrap()
}

fn settings(us: u64) -> CameraSettings {
    CameraSettings { exposure: ExposureTime(us), gain: 0.0 }
}

fn truth(camera: &SimCamera, frame: &Frame) -> std::result::Result<PaintedTruth, OracleError> {
    read_pixels(&frame.pixels, frame.info.width, camera.info().format.levels())
}

async fn opened(bench: &Bench, name: &str, us: u64) -> SimCamera {
    let mut camera = bench.camera(name).unwrap();
    camera.open().await.unwrap();
    camera.apply(settings(us)).await.unwrap();
    camera.arm().await.unwrap();
    camera
}

/// The next frame that counts after `arm`.
async fn good(camera: &mut SimCamera) -> Frame {
    let armed = camera.arm().await.unwrap();
    let mut discard = armed.discard;
    loop {
        let frame = camera.next_frame().await.unwrap();
        if frame.info.exposure_start < armed.not_before {
            continue;
        }
        if discard == 0 {
            return frame;
        }
        discard -= 1;
    }
}

#[tokio::test(start_paused = true)]
async fn a_frame_carries_the_truth_of_its_exposure() {
    let bench = bench(1);
    for name in ["ccd", "ingaas"] {
        let mut camera = opened(&bench, name, 20_000).await;
        let frame = good(&mut camera).await;
        let seen = truth(&camera, &frame).unwrap();
        assert_eq!((seen.tilt_udeg, seen.spin_udeg, seen.slot), (150_000_000, 30_000_000, Some(9)));
        assert_eq!((seen.exposure, seen.moved, seen.shutter_open), (ExposureTime(20_000), false, true));
        assert_eq!(u64::from(seen.frame), frame.info.device_frame_id);
        assert_eq!(frame.pixels.len(), frame.info.width * frame.info.height);
    }
}

/// Frames still in the pipeline say the new setting and were taken with the old one; after `discard` all agree.
#[tokio::test(start_paused = true)]
async fn settings_reach_the_sensor_late_and_arm_says_how_late() {
    let mut file = BenchFile::read(&path("bench.toml")).unwrap();
    file.camera.get_mut("ccd").unwrap().timing.restart_s = None;
    let bench = bench_of(2, file);
    let mut camera = opened(&bench, "ccd", 10_000).await;
    let first = good(&mut camera).await;
    camera.apply(settings(2_000)).await.unwrap();
    let armed = camera.arm().await.unwrap();
    assert_eq!(armed.discard, 2);
    let mut late = 0;
    for i in 0..4 {
        let frame = camera.next_frame().await.unwrap();
        assert_eq!(frame.info.settings.exposure, ExposureTime(2_000));
        assert_eq!(frame.info.device_frame_id, first.info.device_frame_id + 1 + i);
        let old = truth(&camera, &frame).unwrap().exposure == ExposureTime(10_000);
        late += u32::from(old && frame.info.exposure_start >= armed.not_before);
    }
    assert_eq!(late, armed.discard);
    let frame = good(&mut camera).await;
    assert_eq!(truth(&camera, &frame).unwrap().exposure, ExposureTime(2_000));
}

/// With a stream that can be restarted, a long exposure does not hold up a short one.
#[tokio::test(start_paused = true)]
async fn a_short_exposure_after_a_long_one_comes_soon() {
    let bench = bench(10);
    let mut camera = opened(&bench, "ccd", 60_000_000).await;
    bench.surroundings_clock().sleep(Duration::from_secs(1)).await;
    camera.apply(settings(10_000)).await.unwrap();
    let before = bench.surroundings_clock().now();
    let frame = good(&mut camera).await;
    assert_eq!(truth(&camera, &frame).unwrap().exposure, ExposureTime(10_000));
    assert!(frame.info.received - before < Duration::from_millis(300));
}

#[tokio::test(start_paused = true)]
async fn an_exposure_of_a_moving_holder_says_so() {
    let bench = bench(3);
    let mut camera = opened(&bench, "ingaas", 100_000).await;
    bench.surroundings_clock().sleep(Duration::from_secs(3700)).await;
    let frame = good(&mut camera).await;
    assert!(truth(&camera, &frame).unwrap().moved);
}

#[tokio::test(start_paused = true)]
async fn an_unread_queue_gives_old_frames_first_and_arm_empties_it() {
    let bench = bench(4);
    let mut camera = opened(&bench, "ingaas", 1_000).await;
    let before = bench.surroundings_clock().now();
    bench.surroundings_clock().sleep(Duration::from_secs(60)).await;
    let old = camera.next_frame().await.unwrap();
    assert!(old.info.exposure_start < before + Duration::from_secs(1));
    let armed = camera.arm().await.unwrap();
    let id = old.info.device_frame_id;
    let fresh = camera.next_frame().await.unwrap();
    assert!(fresh.info.received >= armed.not_before && fresh.info.device_frame_id > id + 1000);
}

#[tokio::test(start_paused = true)]
async fn every_fault_shows_as_it_would_on_a_real_camera() {
    let bench = bench(5);
    let faults = bench.faults("ingaas").unwrap();
    let mut camera = opened(&bench, "ingaas", 10_000).await;
    let first = good(&mut camera).await;

    faults.push(CameraFault::Stale);
    let stale = camera.next_frame().await.unwrap();
    assert_eq!(stale.pixels, first.pixels);
    assert_eq!(stale.info.device_frame_id, first.info.device_frame_id + 1);

    faults.push(CameraFault::SkippedId);
    let skipped = camera.next_frame().await.unwrap();
    assert_eq!(skipped.info.device_frame_id, stale.info.device_frame_id + 2);

    faults.push(CameraFault::Black);
    let black = camera.next_frame().await.unwrap();
    assert_eq!(truth(&camera, &black), Err(OracleError::NoMark { found: 0 }));

    faults.push(CameraFault::Truncated);
    assert!(camera.next_frame().await.unwrap().info.damaged);

    faults.push(CameraFault::WrongExposure(ExposureTime(40_000)));
    let wrong = camera.next_frame().await.unwrap();
    assert_eq!(wrong.info.settings.exposure, ExposureTime(10_000));
    assert_eq!(truth(&camera, &wrong).unwrap().exposure, ExposureTime(40_000));

    faults.push(CameraFault::NoFrame);
    assert_eq!(camera.next_frame().await.unwrap_err().kind, ErrorKind::Timeout);

    faults.push(CameraFault::Lost);
    assert_eq!(camera.next_frame().await.unwrap_err().kind, ErrorKind::Lost);
    assert_eq!(camera.arm().await.unwrap_err().kind, ErrorKind::Lost);
    camera.open().await.unwrap();
    camera.apply(settings(10_000)).await.unwrap();
    camera.arm().await.unwrap();
    let again = camera.next_frame().await.unwrap();
    assert!(again.info.device_frame_id > wrong.info.device_frame_id);
    assert!(faults.is_empty());
}

/// A setting that is swallowed shows in the registers; frames in between lose nothing of the fault.
#[tokio::test(start_paused = true)]
async fn a_swallowed_setting_is_told_by_the_registers() {
    let bench = bench(5);
    let mut camera = opened(&bench, "ingaas", 10_000).await;
    let faults = bench.faults("ingaas").unwrap();
    faults.push(CameraFault::NotTaken);
    assert_eq!(camera.apply(settings(10_000)).await.unwrap(), settings(10_000), "nothing changes, nothing is lost");
    camera.next_frame().await.unwrap();
    assert_eq!(camera.apply(settings(40_000)).await.unwrap(), settings(10_000));
    assert!(faults.is_empty());
    assert_eq!(camera.apply(settings(40_000)).await.unwrap(), settings(40_000));
}

#[tokio::test(start_paused = true)]
async fn dropping_a_wait_loses_no_frame() {
    let bench = bench(6);
    let clock = bench.surroundings_clock();
    let mut camera = opened(&bench, "ingaas", 500_000).await;
    let first = camera.next_frame().await.unwrap();
    assert!(clock.timeout(Duration::from_millis(100), camera.next_frame()).await.is_err());
    let second = camera.next_frame().await.unwrap();
    assert_eq!(second.info.device_frame_id, first.info.device_frame_id + 1);
}

#[tokio::test(start_paused = true)]
async fn out_of_range_settings_are_refused_with_the_range() {
    let bench = bench(7);
    let mut camera = opened(&bench, "ccd", 10_000).await;
    let error = camera.apply(settings(300_000_000)).await.unwrap_err();
    assert_eq!(error.kind, ErrorKind::Refused);
    assert!(error.message.contains("1 µs to 120 s"), "{error}");
    assert_eq!(camera.apply(settings(10_000)).await.unwrap(), settings(10_000));
    assert!(bench.camera("thermal").is_err());
}

/// Same seed, same pictures; another seed, others. Threads and order play no part.
#[tokio::test(start_paused = true)]
async fn the_seed_decides_the_pictures() {
    let mut pictures = Vec::new();
    for seed in [8, 8, 9] {
        let bench = bench(seed);
        let mut camera = opened(&bench, "ingaas", 20_000).await;
        pictures.push(camera.next_frame().await.unwrap().pixels.clone());
    }
    assert_eq!(pictures[0], pictures[1]);
    assert_ne!(pictures[0], pictures[2]);
}
