//! Packets that belong to no frame of ours: another camera's on the same host, and late ones of an exposure given up.

use crate::bench::{alone, open, options, read, settings, snap, twin};
use goniod_drivers::clock::Clock;
use goniod_drivers::contract::Camera;
use goniod_drivers::devices::aravis::WireFormat;
use goniod_drivers::units::ExposureTime;
use goniod_sim::gige::Reading;
use goniod_sim::gige::gvsp::header;
use std::net::UdpSocket;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// A camera of somebody else that streams block after block over loopback until it is dropped.
struct Neighbour {
    stop: Arc<AtomicBool>,
    thread: Option<std::thread::JoinHandle<u64>>,
}

impl Neighbour {
    fn start() -> Neighbour {
        let stop = Arc::new(AtomicBool::new(false));
        let ends = Arc::clone(&stop);
        let thread = std::thread::spawn(move || {
            let receiver = UdpSocket::bind("127.0.0.1:0").unwrap();
            let sender = UdpSocket::bind("127.0.0.1:0").unwrap();
            let to = receiver.local_addr().unwrap();
            let (mut packet, mut sent) = (Vec::new(), 0);
            while !ends.load(Ordering::SeqCst) {
                for n in 1..=10 {
                    packet.clear();
                    // A block that an opening camera would come to next, were it taken for its own.
                    header(50, 3, n, 0, &mut packet);
                    packet.resize(1_000, 0xff);
                    sent += u64::from(sender.send_to(&packet, to).is_ok());
                }
                std::thread::park_timeout(Duration::from_micros(500));
            }
            sent
        });
        Neighbour { stop, thread: Some(thread) }
    }

    fn end(mut self) -> u64 {
        self.stop.store(true, Ordering::SeqCst);
        self.thread.take().unwrap().join().unwrap()
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn another_cameras_packets_are_never_ours() {
    let _alone = alone().await;
    let neighbour = Neighbour::start();
    let twin = twin(|_| {});
    for round in 0..10 {
        let mut camera = open(options(&twin, |_| {})).await;
        for exposure_us in [1_000, 7_000, 30_000] {
            let frame = snap(&mut camera, exposure_us).await.unwrap();
            let reading = read(&frame, WireFormat::Mono12);
            assert!(matches!(reading, Reading::Whole(tag) if tag.exposure_us == exposure_us), "{round}: {reading:?}");
            camera.stop().await.unwrap();
        }
        let counts = camera.counts();
        assert_eq!((counts.complete, counts.incomplete), (3, 0), "{counts:?}");
        drop(camera);
    }
    let sent = neighbour.end();
    assert!(sent > 1_000, "the neighbour was heard: {sent} packets");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn late_packets_of_an_exposure_given_up_never_reach_the_next_one() {
    let _alone = alone().await;
    let (clock, twin) = (Clock::system(), twin(|_| {}));
    // A slow sender: 23 packets take some 50 ms, and the camera sends on after it was told to stop.
    let mut camera = open(options(&twin, |o| o.packet_delay_ns = 2_000_000)).await;
    for round in 0..10 {
        camera.apply(settings(1_000 + round)).await.unwrap();
        camera.arm().await.unwrap();
        clock.sleep(Duration::from_millis(4 + 4 * round)).await;
        let next = settings(50_000 + round);
        camera.apply(next).await.unwrap();
        let armed = camera.arm().await.unwrap();
        let frame = camera.next_frame().await.unwrap_or_else(|e| panic!("{round}: {e}"));
        let reading = read(&frame, WireFormat::Mono12);
        assert!(
            matches!(reading, Reading::Whole(tag) if ExposureTime(tag.exposure_us) == next.exposure),
            "{round}: {reading:?}"
        );
        assert!(frame.info.exposure_start >= armed.not_before, "{round}: the new exposure, not the one given up");
        // Asked for again, the frame can be whole before the camera has sent it all: it is to be idle in the next round.
        let sent = clock.timeout(Duration::from_secs(10), async {
            while twin.traffic().blocks < 2 * (round + 1) {
                clock.sleep(Duration::from_millis(2)).await;
            }
        });
        sent.await.expect("each exposure is sent to its end, the one given up too");
    }
}
