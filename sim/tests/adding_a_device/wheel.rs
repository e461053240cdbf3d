//! The Halden CW6 driver against the wheel's twin.

use crate::DRIVERS;
use crate::firmware::halden_cw6::{Cw6Fault, HaldenCw6Twin};
use goniod_drivers::clock::Clock;
use goniod_drivers::contract::FilterWheel;
use goniod_drivers::devices::WheelConfig;
use goniod_drivers::error::ErrorKind;
use goniod_drivers::table::Make;
use goniod_drivers::transport::Connector;
use goniod_drivers::units::Slot;
use goniod_sim::firmware::WireFault;
use goniod_sim::front::PipePort;
use std::time::Duration;
use tokio::time::Instant;

struct Wheel {
    port: PipePort<HaldenCw6Twin>,
    driver: Box<dyn FilterWheel>,
}

fn wheel(places: u8) -> Wheel {
    let port = PipePort::new("sim:filter-wheel", HaldenCw6Twin::new(Instant::now()));
    let clock = Clock::system();
    let config =
        WheelConfig { name: "filter_wheel".into(), places, dark: Some(Slot(6)), settle: Duration::from_millis(100) };
    let driver = DRIVERS.iter().find(|d| d.name == "halden-cw6").unwrap();
    let Make::FilterWheel(make) = driver.make else { panic!("a filter wheel is expected") };
    Wheel { driver: make(Box::new(port.connector(clock)), config, clock), port }
}

async fn open() -> Wheel {
    let mut wheel = wheel(6);
    wheel.driver.open().await.unwrap();
    wheel
}

// === impl Wheel ===

impl Wheel {
    fn inject(&self, fault: Cw6Fault) {
        self.port.with(|twin| twin.inject(fault, Instant::now()));
    }

    fn place(&self) -> Option<u8> {
        self.port.peek(|twin| twin.place(Instant::now()))
    }
}

#[tokio::test(start_paused = true)]
async fn the_twin_speaks_the_worked_exchange() {
    let wheel = wheel(6);
    let mut link = wheel.port.connector(Clock::system()).connect().await.unwrap();
    for (request, reply) in
        [("I?", "CW6,1.3,40213"), ("P?", "P3"), ("G5", "K"), ("P?", "P0"), ("G7", "E1"), ("X", "E9")]
    {
        link.send(format!("{request}\r").as_bytes()).await.unwrap();
        let line = link.until(b'\r', Instant::now() + Duration::from_secs(1)).await.unwrap().unwrap();
        assert_eq!(String::from_utf8(line).unwrap(), reply, "{request}");
    }
}

#[tokio::test(start_paused = true)]
async fn open_proves_the_wheel_and_select_proves_the_place() {
    let mut wheel = wheel(6);
    let identity = wheel.driver.open().await.unwrap();
    assert_eq!((identity.firmware.as_str(), identity.serial.as_str()), ("1.3", "40213"));
    assert_eq!(wheel.driver.slot().await.unwrap(), Some(Slot(3)));
    for slot in [5, 6, 1, 4, 3] {
        assert_eq!(wheel.driver.select(Slot(slot)).await.unwrap(), Slot(slot));
        assert_eq!(wheel.place(), Some(slot));
    }
    assert!(wheel.driver.health().await.unwrap().warnings.is_empty());
    for slot in [0, 7, 255] {
        assert_eq!(wheel.driver.select(Slot(slot)).await.unwrap_err().kind, ErrorKind::Refused);
    }
}

#[tokio::test(start_paused = true)]
async fn every_single_wire_fault_on_any_exchange_of_a_turn_is_survived() {
    let faults = [
        WireFault::Late(Duration::from_secs(3)),
        WireFault::NoReply,
        WireFault::Cut(1),
        WireFault::Corrupt(0, 0x01),
        WireFault::Corrupt(1, 0x04),
        WireFault::Drop(1),
        WireFault::Junk(b"\0\0x\r".to_vec()),
        WireFault::Previous,
        WireFault::Duplicate,
    ];
    let mut wheel = open().await;
    let mut slot = 1;
    for fault in faults {
        for before in 0..4 {
            (0..before).for_each(|_| wheel.inject(Cw6Fault::Wire(WireFault::Pass)));
            wheel.inject(Cw6Fault::Wire(fault.clone()));
            slot = slot % 6 + 1;
            wheel.driver.select(Slot(slot)).await.unwrap_or_else(|e| panic!("{fault:?} after {before}: {e}"));
            assert_eq!(wheel.place(), Some(slot), "{fault:?} after {before}");
            assert!(!wheel.port.peek(HaldenCw6Twin::faults_wait) || before > 2, "{fault:?} met no answer");
        }
    }
}

#[tokio::test(start_paused = true)]
async fn an_order_that_is_not_carried_out_is_given_again_and_a_stuck_wheel_is_broken() {
    let mut wheel = open().await;
    wheel.inject(Cw6Fault::Ignores);
    wheel.driver.select(Slot(5)).await.unwrap();
    assert_eq!(wheel.place(), Some(5));
    wheel.inject(Cw6Fault::Stuck(true));
    let error = wheel.driver.select(Slot(2)).await.unwrap_err();
    assert_eq!(error.kind, ErrorKind::Broken);
    assert!(error.message.contains("stuck"), "{error}");
}

#[tokio::test(start_paused = true)]
async fn a_hand_on_the_wheel_is_seen_and_another_device_is_named() {
    let mut wheel = open().await;
    wheel.driver.select(Slot(2)).await.unwrap();
    wheel.inject(Cw6Fault::ByHand(1));
    tokio::time::sleep(Duration::from_secs(2)).await;
    let health = wheel.driver.health().await.unwrap();
    assert!(health.warnings.iter().any(|w| w.contains("slot 2 to slot 3")), "{health:?}");
    let error = self::wheel(12).driver.open().await.unwrap_err();
    assert_eq!(error.kind, ErrorKind::WrongDevice);
    assert!(error.message.contains("12"), "{error}");
}

#[tokio::test(start_paused = true)]
async fn make_safe_goes_to_dark_over_a_fresh_link_and_after_a_dropped_turn() {
    let mut wheel = wheel(6);
    wheel.driver.make_safe().await.unwrap();
    assert_eq!(wheel.place(), Some(6));
    wheel.driver.open().await.unwrap();
    let turned = tokio::time::timeout(Duration::from_secs(1), wheel.driver.select(Slot(4))).await;
    assert!(turned.is_err(), "the turn was dropped on its way");
    wheel.driver.make_safe().await.unwrap();
    assert_eq!(wheel.place(), Some(6));
    wheel.port.unplug();
    assert_eq!(wheel.driver.make_safe().await.unwrap_err().kind, ErrorKind::Lost);
}
