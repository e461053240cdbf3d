//! What goes wrong at night: input/output errors, unplugging, hanging calls, a lost signal, another program.

use crate::bench::{Bench, config, label_is_true, settings};
use crate::shim::doors;
use crate::shim::twin::{Plan, Twin};
use goniod_drivers::clock::Clock;
use goniod_drivers::contract::{Camera, Device};
use goniod_drivers::devices::v4l2::V4l2Config;
use goniod_drivers::error::ErrorKind;
use std::time::Duration;

#[tokio::test]
async fn an_io_error_restarts_the_stream_and_the_settings_settle_anew() {
    let plan = Plan { latency: (5, 5), forgets_at_start: true, ..Plan::default() };
    let mut bench = Bench::open(plan, config("faults-eio")).await;
    for raw in [9, 2187, 27, 729] {
        bench.camera.apply(settings(raw, 4.0)).await.unwrap();
        bench.camera.arm().await.unwrap();
        bench.twin().dequeue_errors = (1, libc::EIO);
        for _ in 0..3 {
            let frame = bench.camera.next_frame().await.unwrap();
            assert!(label_is_true(&frame));
        }
    }
    assert_eq!(bench.camera.counters().await.unwrap().restarts, 4);
}

#[tokio::test]
async fn io_errors_without_end_are_a_broken_camera_not_an_endless_loop() {
    let mut bench = Bench::open(Plan::default(), config("faults-eio-ever")).await;
    bench.camera.apply(settings(9, 4.0)).await.unwrap();
    bench.twin().dequeue_errors = (u32::MAX, libc::EIO);
    bench.twin().stop_fails = true;
    let armed = bench.camera.arm().await;
    // The restarts may be over before the arming; either way it is said and the driver lives.
    if armed.is_ok() {
        let error = bench.camera.next_frame().await.unwrap_err();
        assert_eq!(error.kind, ErrorKind::Broken, "{error}");
        assert!(error.message.contains("3 stream restarts"), "{error}");
    }
    bench.twin().dequeue_errors = (0, 0);
    bench.twin().stop_fails = false;
    bench.camera.open().await.unwrap();
    assert!(label_is_true(&bench.acquire(settings(27, 4.0)).await));
}

#[tokio::test]
async fn an_unplugged_camera_is_lost_until_opened_and_everything_is_proven_again() {
    let wish = V4l2Config { fixed: vec![(crate::shim::twin::GAMMA, 100)], ..config("faults-unplug") };
    let mut bench = Bench::open(Plan::default(), wish).await;
    bench.acquire(settings(81, 7.0)).await;
    bench.camera.arm().await.unwrap();
    bench.twin().unplugged = true;
    let error = loop {
        if let Err(e) = bench.camera.next_frame().await {
            break e;
        }
    };
    assert_eq!(error.kind, ErrorKind::Lost, "{error}");
    assert_eq!(bench.camera.apply(settings(81, 7.0)).await.unwrap_err().kind, ErrorKind::Lost);
    assert_eq!(bench.camera.open().await.unwrap_err().kind, ErrorKind::Lost, "still not there");
    bench.twin().plug_again();
    bench.camera.open().await.unwrap();
    assert_eq!(bench.twin().controls[&crate::shim::twin::GAMMA].value, 100, "defaults after the plug are undone");
    assert!(label_is_true(&bench.acquire(settings(243, 3.0)).await));
    assert_eq!(bench.twin().opens, 2);
}

#[tokio::test]
async fn a_call_that_hangs_is_left_and_a_new_thread_takes_over() {
    let wish = V4l2Config { command_limit: Duration::from_millis(500), ..config("faults-hang") };
    let mut bench = Bench::open(Plan::default(), wish).await;
    bench.camera.apply(settings(81, 7.0)).await.unwrap();
    bench.camera.stop().await.unwrap();
    bench.twin().hang_us = 1_500_000;
    let error = bench.camera.apply(settings(27, 7.0)).await.unwrap_err();
    assert_eq!(error.kind, ErrorKind::Timeout);
    assert!(error.message.contains("hangs for 0.5 s"), "{error}");
    assert_eq!(bench.camera.arm().await.unwrap_err().kind, ErrorKind::Lost);
    // The hanging thread still owns the node; once the call returns it closes it and the new one has it alone.
    Clock::system().sleep(Duration::from_millis(2500)).await;
    bench.camera.open().await.unwrap();
    assert!(label_is_true(&bench.acquire(settings(243, 3.0)).await));
}

#[tokio::test]
async fn a_signal_that_is_gone_is_never_a_picture() {
    let mut bench = Bench::open(Plan::default(), config("faults-signal")).await;
    bench.acquire(settings(81, 7.0)).await;
    bench.camera.arm().await.unwrap();
    assert!(!bench.camera.next_frame().await.unwrap().info.damaged);
    bench.twin().no_signal = true;
    let mut frames = 0;
    while !bench.camera.next_frame().await.unwrap().info.damaged {
        frames += 1;
        assert!(frames < 100, "frames that waited for the reader end");
    }
    let error = bench.camera.arm().await.unwrap_err();
    assert!(error.message.contains("no signal"), "{error}");
    assert!(bench.camera.health().await.unwrap().warnings.contains(&"no signal".to_owned()));
}

#[tokio::test]
async fn a_stream_that_stands_is_a_timeout_with_its_time() {
    let mut bench = Bench::open(Plan::default(), config("faults-silent")).await;
    bench.camera.apply(settings(5000, 7.0)).await.unwrap();
    bench.twin().sensor.silent = true;
    bench.camera.arm().await.unwrap();
    let error = bench.camera.next_frame().await.unwrap_err();
    assert_eq!(error.kind, ErrorKind::Timeout);
    assert!(error.message.contains("no picture for 3.1 s"), "exposure, read-out and interval + 2 s: {error}");
}

#[tokio::test]
async fn a_camera_that_another_program_streams_is_busy() {
    let mut other = Bench::open(Plan::default(), config("faults-busy")).await;
    other.camera.apply(settings(81, 7.0)).await.unwrap();
    let mut ours = goniod_drivers::devices::v4l2::V4l2Camera::new(config("faults-busy"), Clock::system());
    let error = ours.open().await.unwrap_err();
    assert_eq!(error.kind, ErrorKind::Busy);
    assert!(error.message.contains("another program uses the camera"), "{error}");
    other.camera.stop().await.unwrap();
    ours.open().await.unwrap();
}

#[tokio::test]
async fn nothing_is_armed_or_taken_from_a_camera_without_settings() {
    let mut bench = Bench::closed(Plan::default(), config("faults-order"));
    assert_eq!(bench.camera.arm().await.unwrap_err().kind, ErrorKind::Lost);
    assert_eq!(bench.camera.next_frame().await.unwrap_err().kind, ErrorKind::Lost);
    bench.camera.open().await.unwrap();
    assert_eq!(bench.camera.arm().await.unwrap_err().kind, ErrorKind::Refused);
    bench.camera.apply(settings(81, 7.0)).await.unwrap();
    bench.camera.make_safe().await.unwrap();
    assert!(!bench.twin().sensor.streams());
    assert_eq!(bench.camera.arm().await.unwrap_err().kind, ErrorKind::Refused);
}

/// A node without by-id name works, with a warning; dropping the camera frees the node.
#[tokio::test]
async fn an_unstable_node_is_warned_of_and_a_dropped_camera_lets_go() {
    let wish = V4l2Config { node: "/dev/video7-SN42".into(), ..config("faults-node") };
    let twin = doors::plug("/dev/video7-SN42", Twin::new(Plan::default()));
    let mut camera = goniod_drivers::devices::v4l2::V4l2Camera::new(wish, Clock::system());
    camera.open().await.unwrap();
    let health = camera.health().await.unwrap();
    assert!(health.warnings.iter().any(|w| w.contains("/dev/v4l/by-id")), "{health:?}");
    camera.apply(settings(81, 7.0)).await.unwrap();
    assert!(doors::locked(&twin).owner.is_some());
    drop(camera);
    for _ in 0..200 {
        if doors::locked(&twin).owner.is_none() {
            return;
        }
        Clock::system().sleep(Duration::from_millis(20)).await;
    }
    panic!("the thread did not end");
}
