//! The shutters without feedback against their twins: what the driver says is what it sent.

use goniod_drivers::clock::Clock;
use goniod_drivers::contract::Shutter;
use goniod_drivers::contract::ShutterState::{Closed, Open};
use goniod_drivers::devices::ShutterConfig;
use goniod_drivers::error::ErrorKind;
use goniod_drivers::table;
use goniod_drivers::transport::Connector;
use goniod_sim::firmware::open_shutter::{Listener, OpenShutterFault, OpenShutterTwin};
use goniod_sim::front::PipePort;
use std::time::Duration;
use tokio::time::Instant;

struct Beam {
    port: PipePort<OpenShutterTwin>,
    driver: Box<dyn Shutter>,
}

fn beam(listener: Listener) -> Beam {
    let port = PipePort::new("sim:shutter", OpenShutterTwin::new(listener, Instant::now()));
    let name = if listener == Listener::Relay { "lcus-relay" } else { "uniblitz-vcm-d1" };
    let config = ShutterConfig { name: "shutter".into(), settle: Duration::from_millis(50) };
    let clock = Clock::system();
    let driver = table::shutter(name, Box::new(port.connector(clock)), config, clock).unwrap();
    Beam { port, driver }
}

// === impl Beam ===

impl Beam {
    fn inject(&self, fault: OpenShutterFault) {
        self.port.with(|twin| twin.inject(fault, Instant::now()));
    }

    fn light(&self) -> bool {
        self.port.peek(|twin| twin.light_passes(Instant::now()))
    }
}

/// Light after these bytes and 100 ms.
async fn light_after(listener: Listener, bytes: &[u8]) -> bool {
    let beam = beam(listener);
    let mut link = beam.port.connector(Clock::system()).connect().await.unwrap();
    link.send(bytes).await.unwrap();
    tokio::time::sleep(Duration::from_millis(100)).await;
    assert_eq!(link.unsolicited().await.unwrap(), 0, "it never answers");
    beam.light()
}

#[tokio::test(start_paused = true)]
async fn the_uniblitz_twin_knows_every_byte_of_its_sheet() {
    for (bytes, light) in [
        (&b"@"[..], true),
        (b"@A", false),
        (b"@C", false),
        (b"B", true),
        (&[0x80], true),
        (&[0x80, 0x81], false),
        (&[0x90], false),
        (b"D", false),
        (b"xyz\r", false),
    ] {
        assert_eq!(light_after(Listener::Uniblitz, bytes).await, light, "{bytes:?}");
    }
    let beam = beam(Listener::Uniblitz);
    let mut link = beam.port.connector(Clock::system()).connect().await.unwrap();
    link.send(b"B").await.unwrap();
    tokio::time::sleep(Duration::from_secs(1)).await;
    assert!(!beam.light(), "a triggered exposure ends");
}

#[tokio::test(start_paused = true)]
async fn the_relay_twin_finds_its_frames_and_checks_their_sum() {
    for (bytes, light) in [
        (&[0xA0, 0x01, 0x01, 0xA2][..], true),
        (&[0xA0, 0x01, 0x01, 0xA2, 0xA0, 0x01, 0x00, 0xA1], false),
        (&[0xA0, 0x02, 0x01, 0xA3], false),
        (&[0xA0, 0x01, 0x01, 0xA3], false),
        (&[0x00, 0xA0, 0x01, 0xA0, 0x01, 0x01, 0xA2], true),
        (b"hello\r\n", false),
    ] {
        assert_eq!(light_after(Listener::Relay, bytes).await, light, "{bytes:?}");
    }
}

#[tokio::test(start_paused = true)]
async fn the_state_is_what_was_commanded_since_open() {
    for listener in [Listener::Uniblitz, Listener::Relay] {
        let mut beam = beam(listener);
        assert_eq!(beam.driver.state().await.unwrap_err().kind, ErrorKind::Lost);
        beam.inject(OpenShutterFault::Hand(true));
        tokio::time::sleep(Duration::from_secs(1)).await;
        assert!(beam.light());
        let identity = beam.driver.open().await.unwrap();
        assert!(identity.model.contains("no feedback") && identity.serial.is_empty(), "{identity:?}");
        assert!(!beam.light(), "open leaves it closed");
        for state in [Open, Closed, Open, Open, Closed] {
            beam.driver.set(state).await.unwrap();
            assert_eq!((beam.light(), beam.driver.state().await.unwrap()), (state == Open, Some(state)));
        }
        beam.inject(OpenShutterFault::Hand(true));
        tokio::time::sleep(Duration::from_secs(1)).await;
        assert_eq!(beam.driver.state().await.unwrap(), Some(Closed), "a hand cannot be seen: the pictures must tell");
    }
}

#[tokio::test(start_paused = true)]
async fn one_lost_order_does_no_harm() {
    for (listener, bytes) in [(Listener::Uniblitz, 1), (Listener::Relay, 4), (Listener::Relay, 1)] {
        let mut beam = beam(listener);
        beam.driver.open().await.unwrap();
        for state in [Open, Closed] {
            beam.inject(OpenShutterFault::BytesLost(bytes));
            beam.driver.set(state).await.unwrap();
            assert_eq!(beam.light(), state == Open, "{listener:?}");
        }
    }
}

#[tokio::test(start_paused = true)]
async fn a_byte_at_the_opening_of_the_port_does_not_leave_it_open() {
    let mut beam = beam(Listener::Uniblitz);
    beam.inject(OpenShutterFault::Glitch(b'@'));
    beam.driver.open().await.unwrap();
    assert!(!beam.light());
}

#[tokio::test(start_paused = true)]
async fn a_dead_link_makes_the_state_unknown_and_make_safe_finds_a_fresh_one() {
    let mut beam = beam(Listener::Uniblitz);
    beam.driver.open().await.unwrap();
    beam.driver.set(Open).await.unwrap();
    beam.port.unplug_for(Duration::from_secs(5));
    tokio::time::sleep(Duration::from_millis(10)).await;
    assert_eq!(beam.driver.state().await.unwrap_err().kind, ErrorKind::Lost);
    assert_eq!(beam.driver.make_safe().await.unwrap_err().kind, ErrorKind::Lost);
    assert!(beam.light(), "nobody could tell it");
    tokio::time::sleep(Duration::from_secs(6)).await;
    beam.driver.make_safe().await.unwrap();
    assert!(!beam.light());
}

#[tokio::test(start_paused = true)]
async fn a_device_that_answers_is_another_device() {
    let bench = super::bench();
    let clock = Clock::system();
    let wheel = bench.twins.connector("sim:filter-wheel", clock).unwrap();
    let config = ShutterConfig { name: "shutter".into(), settle: Duration::ZERO };
    let mut shutter = table::shutter("uniblitz-vcm-d1", wheel, config, clock).unwrap();
    let error = shutter.open().await.unwrap_err();
    assert_eq!(error.kind, ErrorKind::WrongDevice);
    assert!(error.message.contains("never does"), "{error}");
}
