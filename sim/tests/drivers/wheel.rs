//! The FW212C driver against the wheel's twin.

use super::{Bench, bench, bench_of};
use goniod_drivers::clock::Clock;
use goniod_drivers::error::ErrorKind;
use goniod_drivers::transport::Connector;
use goniod_drivers::units::Slot;
use goniod_sim::firmware::WireFault;
use goniod_sim::firmware::fw212c::WheelFault;
use goniod_sim::pose::PoseSource;
use goniod_sim::twins::{Fault, TwinsSpec};
use std::time::Duration;
use tokio::time::Instant;

async fn open() -> Bench {
    let mut bench = bench();
    bench.wheel.open().await.unwrap();
    bench
}

fn inject(bench: &Bench, fault: WheelFault) {
    bench.twins.inject(Fault::Wheel(fault));
}

fn place(bench: &Bench) -> Option<u8> {
    bench.twins.pose(Instant::now()).slot
}

#[tokio::test(start_paused = true)]
async fn the_twin_speaks_the_worked_exchange() {
    let bench = bench();
    let clock = Clock::system();
    let mut link = bench.twins.wheel.connector(clock).connect().await.unwrap();
    for (request, reply) in [
        ("\r", "\rCommand error CMD_NOT_DEFINED\r"),
        ("*idn?\r", "*idn?\rTHORLABS FW102C/FW212C Filter Wheel version 1.07\r"),
        ("pcount?\r", "pcount?\r12\r"),
        ("pos?\r", "pos?\r3\r"),
        ("pos=5\r", "pos=5\r"),
        ("pos?\r", "pos?\r5\r"),
        ("pos=13\r", "pos=13\rCommand error CMD_ARG_INVALID\r"),
    ] {
        link.send(request.as_bytes()).await.unwrap();
        let text = link.prompt(clock.now() + Duration::from_secs(5)).await.unwrap().unwrap();
        assert_eq!(String::from_utf8(text).unwrap(), reply);
    }
}

#[tokio::test(start_paused = true)]
async fn the_echo_comes_byte_by_byte_and_the_prompt_only_on_arrival() {
    let bench = bench();
    let clock = Clock::system();
    let mut link = bench.twins.wheel.connector(clock).connect().await.unwrap();
    link.send(b"po").await.unwrap();
    tokio::time::sleep(Duration::from_millis(1)).await;
    assert_eq!(link.unsolicited().await.unwrap(), 2);
    link.send(b"s=9\r").await.unwrap();
    let start = clock.now();
    assert_eq!(link.prompt(start + Duration::from_secs(2)).await.unwrap(), None, "withheld");
    assert_eq!(bench.twins.pose(start + Duration::from_secs(1)).slot, None, "unknown while it turns");
    assert!(link.prompt(start + Duration::from_secs(5)).await.unwrap().is_some());
    let took = start.elapsed().as_secs_f64();
    assert!((2.89..2.95).contains(&took), "half a turn takes 2.9 s: {took}");
}

#[tokio::test(start_paused = true)]
async fn open_proves_the_wheel_and_switches_its_sensors_off() {
    let mut bench = bench();
    assert!(bench.twins.wheel.peek(|t| t.sensors_on()));
    let identity = bench.wheel.open().await.unwrap();
    assert_eq!(identity.firmware, "1.07");
    assert!(!bench.twins.wheel.peek(|t| t.sensors_on()));
    assert_eq!(bench.wheel.slot().await.unwrap(), Some(Slot(3)));
    for slot in [5, 12, 1, 7] {
        assert_eq!(bench.wheel.select(Slot(slot)).await.unwrap(), Slot(slot));
        assert_eq!(place(&bench), Some(slot));
    }
    assert!(bench.wheel.health().await.unwrap().warnings.is_empty());
}

#[tokio::test(start_paused = true)]
async fn places_that_do_not_exist_are_refused_before_a_byte_is_sent() {
    let mut bench = open().await;
    bench.twins.wheel.unplug();
    for slot in [0, 13, 255] {
        assert_eq!(bench.wheel.select(Slot(slot)).await.unwrap_err().kind, ErrorKind::Refused);
    }
    assert_eq!(bench.wheel.select(Slot(1)).await.unwrap_err().kind, ErrorKind::Lost);
    bench.twins.wheel.plug();
    bench.wheel.open().await.unwrap();
    bench.wheel.select(Slot(1)).await.unwrap();
}

#[tokio::test(start_paused = true)]
async fn a_wrong_number_of_places_is_a_wrong_device_and_is_never_set() {
    let mut bench = bench();
    inject(&bench, WheelFault::PlaceCount(6));
    let error = bench.wheel.open().await.unwrap_err();
    assert_eq!(error.kind, ErrorKind::WrongDevice);
    assert!(error.message.contains("6 places") && error.message.contains("12"), "{error}");
}

#[tokio::test(start_paused = true)]
async fn every_single_wire_fault_on_any_exchange_of_a_turn_is_survived() {
    let faults = [
        WireFault::Late(Duration::from_millis(1500)),
        WireFault::NoReply,
        WireFault::Cut(4),
        WireFault::Corrupt(5, 0x04),
        WireFault::Corrupt(0, 0x20),
        WireFault::Junk(b"\0\0x> ".to_vec()),
        WireFault::Previous,
        WireFault::Duplicate,
    ];
    let mut bench = open().await;
    let mut slot = 1;
    for fault in faults {
        for before in 0..3 {
            (0..before).for_each(|_| inject(&bench, WheelFault::Wire(WireFault::Pass)));
            inject(&bench, WheelFault::Wire(fault.clone()));
            slot = slot % 12 + 1;
            bench.wheel.select(Slot(slot)).await.unwrap_or_else(|e| panic!("{fault:?} after {before}: {e}"));
            assert_eq!(place(&bench), Some(slot), "{fault:?}");
        }
    }
}

#[tokio::test(start_paused = true)]
async fn a_prompt_before_arrival_is_not_believed() {
    for empty in [false, true] {
        let mut bench = open().await;
        inject(&bench, WheelFault::PromptEarly);
        if empty {
            inject(&bench, WheelFault::PositionEmpty);
        }
        bench.wheel.select(Slot(9)).await.unwrap();
        assert_eq!(place(&bench), Some(9), "empty {empty}");
    }
}

#[tokio::test(start_paused = true)]
async fn a_jammed_wheel_is_broken_after_two_tries() {
    let mut bench = open().await;
    inject(&bench, WheelFault::Jam(true));
    let start = Instant::now();
    let error = bench.wheel.select(Slot(9)).await.unwrap_err();
    assert_eq!(error.kind, ErrorKind::Broken);
    assert!(error.message.contains("slot 9") && error.message.contains("slot 3"), "{error}");
    assert!(start.elapsed() < Duration::from_secs(60));
    inject(&bench, WheelFault::Jam(false));
    bench.wheel.select(Slot(9)).await.unwrap();
}

#[tokio::test(start_paused = true)]
async fn a_button_pressed_is_seen() {
    let mut bench = open().await;
    bench.wheel.select(Slot(5)).await.unwrap();
    inject(&bench, WheelFault::Button(1));
    tokio::time::sleep(Duration::from_secs(2)).await;
    assert_eq!(bench.wheel.slot().await.unwrap(), Some(Slot(6)));
    let health = bench.wheel.health().await.unwrap();
    assert!(health.warnings.iter().any(|w| w.contains("moved by hand from slot 5 to slot 6")), "{health:?}");
}

#[tokio::test(start_paused = true)]
async fn a_restart_is_seen_and_open_mends_it() {
    let mut bench = open().await;
    inject(&bench, WheelFault::Restart);
    tokio::time::sleep(Duration::from_millis(10)).await;
    let health = bench.wheel.health().await.unwrap();
    assert!(health.warnings.iter().any(|w| w.contains("restarted")), "{health:?}");
    assert!(health.warnings.iter().any(|w| w.contains("unasked")), "{health:?}");
    bench.wheel.open().await.unwrap();
    assert!(bench.wheel.health().await.unwrap().warnings.is_empty());
    inject(&bench, WheelFault::RestartOnCommand);
    bench.wheel.select(Slot(8)).await.unwrap();
    assert_eq!(place(&bench), Some(8));
}

#[tokio::test(start_paused = true)]
async fn a_lost_edge_shows_in_the_truth_only() {
    let mut bench = open().await;
    inject(&bench, WheelFault::LostEdge);
    assert_eq!(bench.wheel.select(Slot(5)).await.unwrap(), Slot(5));
    assert_eq!(place(&bench), Some(6), "no question on the wire can tell; the pictures must");
}

#[tokio::test(start_paused = true)]
async fn make_safe_goes_to_dark_even_from_a_queueing_wheel() {
    let mut spec = TwinsSpec::with_serials("1", "2", "3");
    spec.wheel.queues_input = true;
    spec.wheel.speed = 0;
    let mut bench = bench_of(spec);
    bench.wheel.make_safe().await.unwrap();
    assert_eq!(place(&bench), Some(12));
    bench.wheel.open().await.unwrap();
    let turned = tokio::time::timeout(Duration::from_millis(700), bench.wheel.select(Slot(6))).await;
    assert!(turned.is_err(), "the turn was dropped on its way");
    bench.wheel.make_safe().await.unwrap();
    assert_eq!(place(&bench), Some(12));
}

/// Programs that do not wait for the prompt ask while the wheel turns.
#[tokio::test(start_paused = true)]
async fn a_queueing_wheel_takes_up_what_came_in_the_turn_after_its_prompt() {
    let mut spec = TwinsSpec::with_serials("1", "2", "3");
    spec.wheel.queues_input = true;
    let bench = bench_of(spec);
    let clock = Clock::system();
    let mut link = bench.twins.wheel.connector(clock).connect().await.unwrap();
    link.send(b"pos=9\r").await.unwrap();
    link.send(b"pos?\r").await.unwrap();
    for reply in ["pos=9\r", "pos?\r9\r"] {
        let text = link.prompt(clock.now() + Duration::from_secs(10)).await.unwrap().unwrap();
        assert_eq!(String::from_utf8(text).unwrap(), reply);
    }
}

#[tokio::test(start_paused = true)]
async fn another_device_on_the_port_is_named() {
    let bench = bench();
    let clock = Clock::system();
    let shutter = bench.twins.connector("sim:shutter", clock).unwrap();
    let config = goniod_drivers::devices::WheelConfig {
        name: "filter_wheel".into(),
        places: 12,
        dark: None,
        settle: Duration::ZERO,
    };
    let mut wheel = goniod_drivers::table::filter_wheel("thorlabs-fw212c", shutter, config, clock).unwrap();
    let error = wheel.open().await.unwrap_err();
    assert_eq!(error.kind, ErrorKind::WrongDevice);
    assert!(error.message.contains("SC10"), "{error}");
}
