//! Long streams over loopback UDP: nothing lost, nothing incomplete used, with packet loss and without.

use crate::bench::{alone, full, open, options, read, sensor, settings, twin};
use goniod_drivers::contract::Camera;
use goniod_drivers::devices::aravis::{Counts, Trigger, WireFormat};
use goniod_sim::gige::{PixelCode, Reading};

/// One kind of stream.
struct Stream {
    size: (u32, u32),
    format: (PixelCode, WireFormat),
    fps: f64,
    frames: u64,
    drop_per_1000: u32,
}

/// Streams freely; every frame must be whole, and the one after the frame before.
async fn run(s: Stream) -> Counts {
    // A busy machine may hold a thread for a while: a memory of some hundred megabytes on either side bridges that.
    let room = if s.size.0 > 320 { 64 } else { 256 };
    let twin = twin(|c| {
        c.sensor = sensor(s.size.0, s.size.1, s.format.0);
        c.kept_blocks = room;
    });
    let mut camera = open(options(&twin, |o| {
        (o.width, o.height) = (s.size.0 as usize, s.size.1 as usize);
        (o.format, o.chunks) = (s.format.1, false);
        o.trigger = Trigger::FreeRun { frame_rate_hz: s.fps };
        (o.buffers, o.frames_in_flight) = (room, 16);
    }))
    .await;
    twin.faults(|f| f.drop_per_1000 = s.drop_per_1000);
    camera.apply(settings(1_000)).await.unwrap();
    camera.arm().await.unwrap();
    let mut last: Option<(u64, u64)> = None;
    for n in 0..s.frames {
        let frame = camera.next_frame().await.unwrap();
        let reading = read(&frame, s.format.1);
        let Reading::Whole(tag) = reading else {
            panic!("frame {n} of {}: {reading:?}; {:?}; {:?}", s.frames, camera.counts(), twin.traffic())
        };
        if let Some((id, number)) = last {
            let counts = camera.counts();
            assert_eq!(frame.info.device_frame_id, id + 1, "block lost at frame {n}: {counts:?}; {:?}", twin.traffic());
            assert_eq!(tag.frame_number, number + 1, "picture lost at frame {n}");
        }
        last = Some((frame.info.device_frame_id, tag.frame_number));
    }
    // The library's statistics are copied when the link is asked how it is.
    goniod_drivers::contract::Device::health(&mut camera).await.unwrap();
    let counts = camera.counts();
    println!("{:?} {}x{} at {} fps: {counts:?}; twin {:?}", s.format.1, s.size.0, s.size.1, s.fps, twin.traffic());
    assert_eq!(counts.incomplete, 0);
    assert!(counts.complete >= s.frames);
    if s.drop_per_1000 > 0 {
        let traffic = twin.traffic();
        assert!(traffic.dropped > 0 && traffic.resent > 0, "packets were lost and asked for again: {traffic:?}");
    }
    counts
}

/// A rate that the kernel's socket buffer bridges: with Debian's own 208 KiB a stalled reader loses whole frames.
fn rate(fps: f64) -> f64 {
    let granted = std::fs::read_to_string("/proc/sys/net/core/rmem_max").ok().and_then(|text| text.trim().parse().ok());
    let slow = granted.is_none_or(|bytes: u64| bytes < 4 << 20);
    if slow {
        println!("net.core.rmem_max is {granted:?}, below 4 MiB: a tenth of the rate");
    }
    if slow { fps / 10.0 } else { fps }
}

fn small(frames: u64) -> Stream {
    Stream {
        size: (320, 256),
        format: (PixelCode::Mono16, WireFormat::Mono16),
        fps: rate(200.0),
        frames,
        drop_per_1000: 0,
    }
}

fn large(frames: u64) -> Stream {
    Stream {
        size: (1280, 1024),
        format: (PixelCode::Mono8, WireFormat::Mono8),
        fps: rate(if full() { 40.0 } else { 30.0 }),
        ..small(frames)
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn small_frames_all_arrive_whole() {
    let _alone = alone().await;
    run(small(if full() { 10_000 } else { 300 })).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn large_frames_all_arrive_whole() {
    let _alone = alone().await;
    run(large(if full() { 10_000 } else { 60 })).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn five_packets_lost_of_a_thousand_are_all_recovered() {
    let _alone = alone().await;
    let loss = 5;
    run(Stream { drop_per_1000: loss, ..small(if full() { 10_000 } else { 200 }) }).await;
    run(Stream { drop_per_1000: loss, fps: rate(15.0), ..large(if full() { 1_000 } else { 30 }) }).await;
}
