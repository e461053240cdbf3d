//! The SMC100 driver against the boxes' twin.

use super::axis;
use goniod_drivers::clock::Clock;
use goniod_drivers::contract::RotaryAxis;
use goniod_drivers::error::ErrorKind;
use goniod_drivers::table;
use goniod_drivers::transport::{Connector, Link};
use goniod_drivers::units::Degrees;
use goniod_sim::firmware::WireFault;
use goniod_sim::firmware::smc100::{Smc100Fault, Smc100Twin, SmcStage};
use goniod_sim::front::PipePort;
use std::time::Duration;
use tokio::time::Instant;

struct Chain {
    port: PipePort<Smc100Twin>,
    axes: Vec<Box<dyn RotaryAxis>>,
}

fn chain() -> Chain {
    let stages = [(1, "1001"), (2, "1002"), (3, "1003")].map(|(address, serial)| SmcStage::new(address, serial));
    let port = PipePort::new("sim:holder", Smc100Twin::new(stages.into(), Instant::now()));
    let axes = vec![axis("tilt", 1, "1001"), axis("spin", 2, "1002"), axis("changer", 3, "1003")];
    let clock = Clock::system();
    let axes = table::holder("newport-smc100", Box::new(port.connector(clock)), axes, clock).unwrap();
    Chain { port, axes }
}

async fn homed() -> Chain {
    let mut c = chain();
    c.axes[0].open().await.unwrap();
    c.axes[0].home().await.unwrap();
    c
}

// === impl Chain ===

impl Chain {
    fn inject(&self, fault: Smc100Fault) {
        self.port.with(|twin| twin.inject(fault, Instant::now()));
    }

    fn true_angle(&self, address: u8) -> f64 {
        self.port.peek(|twin| twin.angle_deg(address, Instant::now())).unwrap()
    }
}

async fn say(link: &mut Link, request: &str) -> Vec<String> {
    link.send(format!("{request}\r\n").as_bytes()).await.unwrap();
    let mut lines = Vec::new();
    while let Some(line) = link.line(Instant::now() + Duration::from_millis(60)).await.unwrap() {
        lines.push(String::from_utf8(line).unwrap());
    }
    lines
}

#[tokio::test(start_paused = true)]
async fn the_twin_speaks_the_worked_exchange() {
    let c = chain();
    let mut link = c.port.connector(Clock::system()).connect().await.unwrap();
    let link = &mut link;
    assert_eq!(say(link, "1TS").await, ["1TS00000A"]);
    assert!(say(link, "1PA5").await.is_empty(), "refused without any reply");
    assert_eq!(say(link, "1TE").await, ["1TEH"]);
    assert_eq!(say(link, "1TE").await, ["1TE@"], "reading clears it");
    assert!(say(link, "1OR").await.is_empty());
    assert_eq!(say(link, "1TS").await, ["1TS00001E"]);
    assert_eq!(say(link, "2TS").await, ["2TS00000A"], "the neighbour does not move");
    tokio::time::sleep(Duration::from_secs(10)).await;
    assert_eq!(say(link, "1TS").await, ["1TS000032"]);
    say(link, "1PA30").await;
    assert_eq!(say(link, "1TS").await, ["1TS000028"]);
    tokio::time::sleep(Duration::from_secs(10)).await;
    assert_eq!(say(link, "1TS").await, ["1TS000033"]);
    assert_eq!(say(link, "1TP").await, ["1TP30"]);
    assert_eq!(say(link, "01TH").await, ["1TH30"], "two digits are an address too");
}

#[tokio::test(start_paused = true)]
async fn the_twin_answers_what_other_programs_send() {
    let c = chain();
    let mut link = c.port.connector(Clock::system()).connect().await.unwrap();
    let link = &mut link;
    let all = say(link, "1ZT").await;
    assert!(all.len() == 19 && all.first().unwrap() == "1PW1" && all.last().unwrap() == "1PW0", "{all:?}");
    assert_eq!(say(link, "1ID").await, say(link, "1ID?").await);
    assert_eq!(say(link, "1VA?").await, ["1VA10"]);
    assert_eq!(say(link, "1PT10").await, ["1PT1.25"]);
    assert!(say(link, "4TS").await.is_empty(), "no such box");
    for (request, letter) in
        [("1XY", "A"), ("1VA5", "H"), ("1PAx", "H"), ("1OH0", "C"), ("1PW2", "C"), ("1MM0", "H"), ("1PW0", "H")]
            .into_iter()
            .chain([("1SA3", "H"), ("1IDURS50", "H"), ("1JD", "H"), ("1JM2", "C"), ("1VA", "C"), ("1JM0", "@")])
    {
        assert!(say(link, request).await.is_empty());
        assert_eq!(say(link, "1TE").await, [format!("1TE{letter}")], "{request}");
    }
    say(link, "1PW1").await;
    say(link, "1OH5").await;
    assert_eq!(say(link, "1TE").await, ["1TE@"]);
    assert_eq!(say(link, "1OH?").await, ["1OH5"]);
    for (set, asked, answer) in [("1SA4", "1SA?", "1SA4"), ("1ZX1", "1ZX?", "1ZX1"), ("1IDURS50", "1ID?", "1IDURS50")] {
        assert!(say(link, set).await.is_empty());
        assert_eq!(say(link, asked).await, [answer]);
    }
    assert_eq!(say(link, "1JM?").await, ["1JM0"]);
    assert_eq!(say(link, "1TS").await, ["1TS000014"], "it still answers to its own address");
    say(link, "1PW0").await;
    assert!(say(link, "1TS").await.is_empty(), "silent while the flash is written");
    tokio::time::sleep(Duration::from_secs(4)).await;
    assert_eq!(say(link, "1TS").await, ["1TS00000C"]);
    for (setup, request, letter) in [("1OR", "1OR", "E"), ("", "1PA1", "L")] {
        say(link, setup).await;
        say(link, request).await;
        assert_eq!(say(link, "1TE").await, [format!("1TE{letter}")], "{request}");
    }
    tokio::time::sleep(Duration::from_secs(20)).await;
    say(link, "1PAnan").await;
    assert_eq!(say(link, "1TE").await, ["1TEC"]);
    say(link, "1PA800").await;
    assert_eq!(say(link, "1TB?").await, ["1TBG Displacement out of limits"]);
    say(link, "1PA90").await;
    say(link, "ST").await;
    tokio::time::sleep(Duration::from_secs(2)).await;
    assert_eq!(say(link, "1TS").await, ["1TS000033"], "a stop without address is for all");
}

#[tokio::test(start_paused = true)]
async fn open_home_and_move_find_the_true_angle() {
    let mut c = chain();
    let identity = c.axes[0].open().await.unwrap();
    assert!(identity.model.contains("URS100CC") && identity.serial == "1001", "{identity:?}");
    assert_eq!(c.axes[0].position().await.unwrap(), None);
    assert_eq!(c.axes[0].move_to(Degrees(30.0)).await.unwrap_err().kind, ErrorKind::Refused);
    for axis in &mut c.axes {
        axis.open().await.unwrap();
        axis.home().await.unwrap();
    }
    let [a, b, _] = c.axes.as_mut_slice() else { panic!("three axes") };
    let moves = tokio::join!(a.move_to(Degrees(123.4)), b.move_to(Degrees(45.0)));
    assert!(moves.0.unwrap().distance(Degrees(123.4)).0 < 0.001);
    moves.1.unwrap();
    assert!((c.true_angle(1) - 123.4).abs() < 0.001 && (c.true_angle(2) - 45.0).abs() < 0.001);
    c.axes[0].open().await.unwrap();
    assert!(c.axes[0].position().await.unwrap().is_some(), "the box itself knows its reference");
    assert!(c.axes[0].health().await.unwrap().warnings.is_empty());
    let error = c.axes[0].move_to(Degrees(-6.0)).await.unwrap_err();
    assert!(error.message.contains("nothing was sent"), "{error}");
}

#[tokio::test(start_paused = true)]
async fn another_stage_is_a_wrong_device() {
    let stages = vec![SmcStage::new(1, "7777")];
    let port = PipePort::new("sim:holder", Smc100Twin::new(stages, Instant::now()));
    let clock = Clock::system();
    let connector = Box::new(port.connector(clock));
    let mut axes = table::holder("newport-smc100", connector, vec![axis("tilt", 1, "1001")], clock).unwrap();
    let error = axes[0].open().await.unwrap_err();
    assert_eq!(error.kind, ErrorKind::WrongDevice);
    assert!(error.message.contains("7777") && error.message.contains("1001"), "{error}");
}

#[tokio::test(start_paused = true)]
async fn every_single_wire_fault_on_any_exchange_of_a_move_is_survived() {
    let faults = [
        WireFault::Late(Duration::from_millis(700)),
        WireFault::NoReply,
        WireFault::Cut(4),
        WireFault::Corrupt(4, 0x01),
        WireFault::Corrupt(8, 0x01),
        WireFault::Junk(b"\xff\x00junk".to_vec()),
        WireFault::Previous,
        WireFault::Duplicate,
    ];
    let mut c = homed().await;
    let mut target = 10.0;
    for fault in faults {
        for before in 0..10 {
            (0..before).for_each(|_| c.inject(Smc100Fault::Wire(WireFault::Pass)));
            c.inject(Smc100Fault::Wire(fault.clone()));
            target = if target > 100.0 { 10.0 } else { target + 7.0 };
            let reached = c.axes[0].move_to(Degrees(target)).await;
            reached.unwrap_or_else(|e| panic!("{fault:?} after {before}: {e}"));
            assert!((c.true_angle(1) - target).abs() < 0.01, "{fault:?} after {before}");
        }
    }
}

#[tokio::test(start_paused = true)]
async fn a_restart_voids_the_reference_at_rest_and_in_a_move() {
    let mut c = homed().await;
    c.axes[0].move_to(Degrees(20.0)).await.unwrap();
    c.inject(Smc100Fault::Restart(1));
    let error = c.axes[0].move_to(Degrees(40.0)).await.unwrap_err();
    assert_eq!(error.kind, ErrorKind::Broken);
    assert!(error.message.contains("lost its reference"), "{error}");
    c.axes[0].open().await.unwrap();
    assert_eq!(c.axes[0].position().await.unwrap(), None);
    c.axes[0].home().await.unwrap();
    let port = c.port.clone();
    tokio::spawn(async move {
        tokio::time::sleep(Duration::from_secs(4)).await;
        port.with(|twin| twin.inject(Smc100Fault::Restart(1), Instant::now()));
    });
    assert_eq!(c.axes[0].move_to(Degrees(90.0)).await.unwrap_err().kind, ErrorKind::Broken);
    c.axes[0].open().await.unwrap();
    c.axes[0].home().await.unwrap();
    c.inject(Smc100Fault::RestartOnCommand);
    assert!(c.axes[0].move_to(Degrees(0.0)).await.is_err());
}

#[tokio::test(start_paused = true)]
async fn faults_of_the_box_fail_with_their_kind() {
    for (fault, word) in [
        (Smc100Fault::Jam(1, 50.0), "following error"),
        (Smc100Fault::NeverDone(1), "still moving"),
        (Smc100Fault::Disabled(1), "disabled"),
    ] {
        let mut c = homed().await;
        c.inject(fault.clone());
        let error = c.axes[0].move_to(Degrees(90.0)).await.unwrap_err();
        assert_eq!(error.kind, ErrorKind::Broken, "{fault:?}: {error}");
        assert!(error.message.contains(word), "{fault:?}: {error}");
        c.axes[0].open().await.unwrap();
        c.axes[0].home().await.unwrap();
        c.axes[0].move_to(Degrees(90.0)).await.unwrap();
        assert!((c.true_angle(1) - 90.0).abs() < 0.01, "{fault:?}");
    }
    let mut c = chain();
    c.inject(Smc100Fault::HomeTimeout(1));
    c.axes[0].open().await.unwrap();
    let error = c.axes[0].home().await.unwrap_err();
    assert!(error.message.contains("homing time-out"), "{error}");
    c.axes[0].home().await.unwrap();
    c.inject(Smc100Fault::Overshoot(1, 0.5));
    c.axes[0].move_to(Degrees(10.0)).await.unwrap();
    assert!((c.true_angle(1) - 10.0).abs() < 0.01);
}

#[tokio::test(start_paused = true)]
async fn make_safe_stops_a_moving_axis() {
    let mut c = homed().await;
    let moved = tokio::time::timeout(Duration::from_secs(4), c.axes[0].move_to(Degrees(180.0))).await;
    assert!(moved.is_err(), "the move was dropped on its way");
    c.axes[0].make_safe().await.unwrap();
    let stands = c.true_angle(1);
    tokio::time::sleep(Duration::from_secs(5)).await;
    assert!((20.0..60.0).contains(&stands) && (c.true_angle(1) - stands).abs() < 1e-9);
}
