//! The Optec driver against the wheel's twin.

use goniod_drivers::clock::Clock;
use goniod_drivers::contract::FilterWheel;
use goniod_drivers::devices::WheelConfig;
use goniod_drivers::error::ErrorKind;
use goniod_drivers::table;
use goniod_drivers::transport::Connector;
use goniod_drivers::units::Slot;
use goniod_sim::firmware::WireFault;
use goniod_sim::firmware::ifw::{IfwFault, IfwTwin};
use goniod_sim::front::PipePort;
use std::time::Duration;
use tokio::time::Instant;

struct Wheel {
    port: PipePort<IfwTwin>,
    driver: Box<dyn FilterWheel>,
}

fn wheel(places: u8) -> Wheel {
    let port = PipePort::new("sim:filter-wheel", IfwTwin::new(places, Instant::now()));
    let clock = Clock::system();
    let config =
        WheelConfig { name: "filter_wheel".into(), places: 9, dark: Some(Slot(9)), settle: Duration::from_millis(100) };
    let driver = table::filter_wheel("optec-ifw", Box::new(port.connector(clock)), config, clock).unwrap();
    Wheel { port, driver }
}

async fn open() -> Wheel {
    let mut wheel = wheel(9);
    wheel.driver.open().await.unwrap();
    wheel
}

// === impl Wheel ===

impl Wheel {
    fn inject(&self, fault: IfwFault) {
        self.port.with(|twin| twin.inject(fault, Instant::now()));
    }

    fn place(&self) -> Option<u8> {
        self.port.peek(|twin| twin.place(Instant::now()))
    }
}

#[tokio::test(start_paused = true)]
async fn the_twin_speaks_the_worked_exchange() {
    let wheel = wheel(5);
    let mut link = wheel.port.connector(Clock::system()).connect().await.unwrap();
    link.send(b"WFILTR\n\r").await.unwrap();
    assert_eq!(link.until(b'\r', Instant::now() + Duration::from_secs(5)).await.unwrap(), None, "silent before WSMODE");
    for (request, reply) in [
        ("WSMODE", "!"),
        ("WHOME", "A"),
        ("WIDENT", "A"),
        ("WFILTR", "1"),
        ("WGOTO4", "*"),
        ("WFILTR", "4"),
        ("WGOTO9", "ER=5"),
        ("WREAD", "FILTER-1FILTER-2FILTER-3FILTER-4FILTER-5"),
        ("WVAAAA", "V= 2.04"),
        ("WLOADA*RED     GREEN   BLUE    CLEAR   DARK    ", "!"),
        ("WREAD", "RED     GREEN   BLUE    CLEAR   DARK    "),
        ("WEXITS", "END"),
    ] {
        link.send(format!("{request}\n\r").as_bytes()).await.unwrap();
        let line = link.until(b'\r', Instant::now() + Duration::from_secs(40)).await.unwrap().unwrap();
        assert_eq!(String::from_utf8(line).unwrap(), format!("{reply}\n"), "{request}");
    }
    link.send(b"WSMODE\n\rWHOME\n\r").await.unwrap();
    for reply in [b"!\n", b"A\n"] {
        let line = link.until(b'\r', Instant::now() + Duration::from_secs(40)).await.unwrap().unwrap();
        assert_eq!(line, reply);
    }
    let begun = Instant::now();
    link.send(b"WGOTO5\n\r").await.unwrap();
    link.until(b'\r', Instant::now() + Duration::from_secs(40)).await.unwrap().unwrap();
    assert!((2.0..2.1).contains(&begun.elapsed().as_secs_f64()), "from 1 to 5 of five is one place back");
    link.send(b"WEXITS\n\r").await.unwrap();
    link.until(b'\r', Instant::now() + Duration::from_secs(1)).await.unwrap().unwrap();
    link.send(b"WSMODEWFILTR").await.unwrap();
    let line = link.until(b'\r', Instant::now() + Duration::from_secs(1)).await.unwrap().unwrap();
    assert_eq!(line, b"!\n", "a request needs no end");
}

#[tokio::test(start_paused = true)]
async fn open_homes_the_wheel_and_select_proves_the_place() {
    let mut wheel = open().await;
    assert_eq!(wheel.driver.slot().await.unwrap(), Some(Slot(1)));
    for slot in [5, 9, 1, 7] {
        assert_eq!(wheel.driver.select(Slot(slot)).await.unwrap(), Slot(slot));
        assert_eq!(wheel.place(), Some(slot));
    }
    let identity = wheel.driver.open().await.unwrap();
    assert_eq!((identity.serial.as_str(), identity.firmware.as_str()), ("wheel A", "2.04"));
    assert!(wheel.driver.health().await.unwrap().warnings.is_empty());
    for slot in [0, 10, 255] {
        assert_eq!(wheel.driver.select(Slot(slot)).await.unwrap_err().kind, ErrorKind::Refused);
    }
}

#[tokio::test(start_paused = true)]
async fn another_wheel_is_a_wrong_device() {
    let error = wheel(5).driver.open().await.unwrap_err();
    assert_eq!(error.kind, ErrorKind::WrongDevice);
    assert!(error.message.contains("5 places") && error.message.contains('9'), "{error}");
    let mut wheel = open().await;
    wheel.inject(IfwFault::Wheel('C'));
    let error = wheel.driver.open().await.unwrap_err();
    assert_eq!(error.kind, ErrorKind::WrongDevice);
    assert!(error.message.contains("wheel C") && error.message.contains("wheel A"), "{error}");
}

#[tokio::test(start_paused = true)]
async fn every_single_wire_fault_on_any_exchange_of_a_turn_is_survived() {
    let faults = [
        IfwFault::Wire(WireFault::Late(Duration::from_secs(7))),
        IfwFault::Wire(WireFault::NoReply),
        IfwFault::Wire(WireFault::Cut(1)),
        IfwFault::Wire(WireFault::Corrupt(0, 0x01)),
        IfwFault::Wire(WireFault::Corrupt(2, 0x04)),
        IfwFault::Wire(WireFault::Junk(b"\0\0x\r".to_vec())),
        IfwFault::Wire(WireFault::Previous),
        IfwFault::Wire(WireFault::Duplicate),
        IfwFault::NoLineFeed,
        IfwFault::StrayLineFeed,
    ];
    let mut wheel = open().await;
    let mut slot = 1;
    for fault in faults {
        for before in 0..3 {
            (0..before).for_each(|_| wheel.inject(IfwFault::Wire(WireFault::Pass)));
            wheel.inject(fault.clone());
            slot = slot % 9 + 1;
            wheel.driver.select(Slot(slot)).await.unwrap_or_else(|e| panic!("{fault:?} after {before}: {e}"));
            assert_eq!(wheel.place(), Some(slot), "{fault:?} after {before}");
        }
    }
}

#[tokio::test(start_paused = true)]
async fn a_slip_and_a_restart_are_homed_and_a_stuck_wheel_is_broken() {
    let mut wheel = open().await;
    wheel.inject(IfwFault::Slips);
    wheel.driver.select(Slot(5)).await.unwrap();
    assert_eq!(wheel.place(), Some(5));
    for fault in [IfwFault::Restart, IfwFault::RestartOnCommand] {
        wheel.inject(fault.clone());
        wheel.driver.select(Slot(7)).await.unwrap_or_else(|e| panic!("{fault:?}: {e}"));
        assert_eq!(wheel.place(), Some(7), "{fault:?}");
        wheel.driver.select(Slot(2)).await.unwrap();
    }
    let health = wheel.driver.health().await.unwrap();
    assert!(health.warnings.iter().any(|w| w.contains("restarted 2 times")), "{health:?}");
    wheel.inject(IfwFault::Stuck(true));
    let error = wheel.driver.select(Slot(4)).await.unwrap_err();
    assert_eq!(error.kind, ErrorKind::Broken);
    assert!(error.message.contains("stuck"), "{error}");
    wheel.inject(IfwFault::Stuck(false));
    wheel.driver.open().await.unwrap();
    wheel.driver.select(Slot(4)).await.unwrap();
}

#[tokio::test(start_paused = true)]
async fn a_button_is_seen_and_a_lost_step_only_in_the_truth() {
    let mut wheel = open().await;
    wheel.driver.select(Slot(5)).await.unwrap();
    wheel.inject(IfwFault::Button(1));
    tokio::time::sleep(Duration::from_secs(3)).await;
    assert_eq!(wheel.driver.slot().await.unwrap(), Some(Slot(6)));
    let health = wheel.driver.health().await.unwrap();
    assert!(health.warnings.iter().any(|w| w.contains("slot 5 to slot 6")), "{health:?}");
    wheel.inject(IfwFault::OffByOne);
    wheel.driver.select(Slot(2)).await.unwrap();
    assert_eq!(wheel.place(), Some(3), "no question on the wire can tell; the pictures must");
}

#[tokio::test(start_paused = true)]
async fn make_safe_goes_to_dark_over_a_fresh_link_and_after_a_dropped_turn() {
    let mut wheel = wheel(9);
    wheel.driver.make_safe().await.unwrap();
    assert_eq!(wheel.place(), Some(9));
    wheel.driver.open().await.unwrap();
    let turned = tokio::time::timeout(Duration::from_secs(3), wheel.driver.select(Slot(6))).await;
    assert!(turned.is_err(), "the turn was dropped on its way");
    wheel.driver.make_safe().await.unwrap();
    assert_eq!(wheel.place(), Some(9));
}
