//! The ESP301 driver against the controller's twin.

use super::axis;
use goniod_drivers::clock::Clock;
use goniod_drivers::contract::RotaryAxis;
use goniod_drivers::error::ErrorKind;
use goniod_drivers::table;
use goniod_drivers::transport::Connector;
use goniod_drivers::units::Degrees;
use goniod_sim::firmware::WireFault;
use goniod_sim::firmware::esp301::{Esp301Fault, Esp301Twin, EspStage};
use goniod_sim::front::PipePort;
use std::time::Duration;
use tokio::time::Instant;

struct Controller {
    port: PipePort<Esp301Twin>,
    axes: Vec<Box<dyn RotaryAxis>>,
}

fn controller_of(serials: [&str; 3], baud: u32) -> Controller {
    let twin = Esp301Twin::new(serials.map(EspStage::new).into(), baud, Instant::now());
    let port = PipePort::new("sim:holder", twin);
    let axes = [("tilt", 1, "1001"), ("spin", 2, "1002"), ("changer", 3, "1003")].map(|(name, number, serial)| {
        let mut config = axis(name, 1, serial);
        config.axis = number;
        config
    });
    let clock = Clock::system();
    let axes = table::holder("newport-esp301", Box::new(port.connector(clock)), axes.into(), clock).unwrap();
    Controller { port, axes }
}

fn controller() -> Controller {
    controller_of(["1001", "1002", "1003"], 921_600)
}

async fn homed() -> Controller {
    let mut c = controller();
    c.axes[0].open().await.unwrap();
    c.axes[0].home().await.unwrap();
    c
}

// === impl Controller ===

impl Controller {
    fn inject(&self, fault: Esp301Fault) {
        self.port.with(|twin| twin.inject(fault, Instant::now()));
    }

    fn true_angle(&self, axis: u8) -> f64 {
        self.port.peek(|twin| twin.angle_deg(axis, Instant::now())).unwrap()
    }
}

/// Sends a line and gives all lines that come within 100 ms.
async fn say(link: &mut goniod_drivers::transport::Link, request: &str) -> Vec<String> {
    link.send(format!("{request}\r").as_bytes()).await.unwrap();
    let mut lines = Vec::new();
    while let Some(line) = link.line(Instant::now() + Duration::from_millis(100)).await.unwrap() {
        lines.push(String::from_utf8(line).unwrap());
    }
    lines
}

/// The code in front of a report.
fn code(lines: &[String]) -> u16 {
    lines.last().unwrap().split(',').next().unwrap().parse().unwrap()
}

#[tokio::test(start_paused = true)]
async fn the_twin_speaks_the_worked_exchange() {
    let c = controller();
    let mut link = c.port.connector(Clock::system()).connect().await.unwrap();
    let link = &mut link;
    assert_eq!(say(link, "VE?").await, ["ESP301 Version 3.0.1 6/1/99"]);
    let report = say(link, "TB?").await;
    assert!(report[0].starts_with("0, ") && report[0].ends_with(", NO ERROR DETECTED"), "{report:?}");
    assert_eq!(say(link, "1ID?").await, ["URS100BCC, SN1001"]);
    assert_eq!(say(link, "1SN?").await, ["7"]);
    assert_eq!(say(link, "1MO?").await, ["0"]);
    assert!(say(link, "1PA30").await.is_empty(), "nothing is answered");
    assert_eq!(code(&say(link, "TB?").await), 113, "motor not enabled");
    assert!(say(link, "1MO").await.is_empty());
    assert_eq!(code(&say(link, "TB?").await), 0);
    say(link, "1SR180;1SL-180").await;
    say(link, "1OR1").await;
    assert_eq!(say(link, "1MD?").await, ["0"]);
    say(link, "1PA5").await;
    assert_eq!(say(link, "TE?").await, ["130"], "not allowed during homing");
    tokio::time::sleep(Duration::from_secs(20)).await;
    assert_eq!(say(link, "1MD?").await, ["1"]);
    assert_eq!(say(link, "1TP?").await, ["0.0000"]);
    assert_eq!(say(link, "PH").await, ["0H, 1H"], "on the home switch");
    say(link, "1PA200").await;
    let report = say(link, "TB?").await;
    assert!(report[0].starts_with("106, ") && report[0].ends_with("AXIS-1 POSITIVE SOFTWARE LIMIT DETECTED"));
    say(link, "1PA30").await;
    assert_eq!(say(link, "1MD?;1DP").await, ["0", "30.0000"], "several on a line, and reports without question mark");
    say(link, "1ST").await;
    tokio::time::sleep(Duration::from_secs(1)).await;
    assert_eq!(say(link, "1MD?").await, ["1"]);
}

#[tokio::test(start_paused = true)]
async fn the_twin_answers_what_other_programs_send() {
    let c = controller();
    let mut link = c.port.connector(Clock::system()).connect().await.unwrap();
    let link = &mut link;
    for (request, reply) in [
        ("01SN?", "7"),
        ("01ZB?", "300H"),
        ("01SU?", "0.0005"),
        ("1VU?", "40"),
        ("1QM?", "1"),
        ("TS", "@"),
        ("2TP", "0.0000"),
        ("3MD", "1"),
        ("ZU?", "700H"),
    ] {
        assert_eq!(say(link, request).await, [reply], "{request}");
    }
    for (request, error) in [
        ("XY", 6),
        ("1XY5", 6),
        ("VA5", 37),
        ("4ST", 9),
        ("04TP?", 9),
        ("1VA", 38),
        ("1VA999", 110),
        ("2AC999", 211),
        ("1SN12", 101),
        ("3PAx", 313),
        ("1HN1,2", 15),
        ("5EX", 35),
        ("101EP", 7),
        ("QP", 26),
        ("1DL", 27),
        ("SA31", 7),
    ] {
        assert!(say(link, request).await.is_empty(), "{request} is silent");
        assert_eq!(code(&say(link, "TB?").await), error, "{request}");
        assert_eq!(code(&say(link, "TB?").await), 0, "{request} left one report");
    }
    for line in ["7EP", "1MO;1PR2;1WS", "QP", "7EX3"] {
        assert!(say(link, line).await.is_empty(), "{line} is silent");
    }
    tokio::time::sleep(Duration::from_secs(9)).await;
    assert_eq!(say(link, "1TP?;SA?;7LP").await, ["6.0000", "1", "1MO", "1PR2", "1WS"], "a program of three steps");
    say(link, "1DH0").await;
    for _ in 0..12 {
        say(link, "XY").await;
    }
    for _ in 0..10 {
        assert_eq!(say(link, "TE?").await, ["6"]);
    }
    assert_eq!(say(link, "TE?").await, ["0"], "ten are kept");
    say(link, "1MO;1PR10").await;
    assert_eq!(say(link, "TS").await, ["Q"], "axis 1 moves, motor on");
    say(link, "1WS100").await;
    let sent = Instant::now();
    assert!(say(link, "1MD?").await.is_empty(), "WS holds what follows");
    assert_eq!(link.line(Instant::now() + Duration::from_secs(5)).await.unwrap().unwrap(), b"1");
    assert!(sent.elapsed() > Duration::from_secs(1));
}

#[tokio::test(start_paused = true)]
async fn replies_take_the_time_of_the_line() {
    let c = controller_of(["1001", "1002", "1003"], 19_200);
    let mut link = c.port.connector(Clock::system()).connect().await.unwrap();
    let start = Instant::now();
    link.send(b"VE?\r").await.unwrap();
    link.line(start + Duration::from_secs(1)).await.unwrap().unwrap();
    let ms = start.elapsed().as_millis();
    assert!((20..35).contains(&ms), "5 to 15 ms and 29 bytes of 0.52 ms: {ms}");
}

#[tokio::test(start_paused = true)]
async fn open_home_and_move_find_the_true_angle() {
    let mut c = controller();
    let identity = c.axes[0].open().await.unwrap();
    assert_eq!((identity.model.as_str(), identity.serial.as_str()), ("Newport URS100BCC", "1001"));
    assert!(identity.firmware.contains("ESP301"), "{identity:?}");
    assert_eq!(c.axes[0].position().await.unwrap(), None);
    assert_eq!(c.axes[0].move_to(Degrees(30.0)).await.unwrap_err().kind, ErrorKind::Broken);
    c.axes[0].home().await.unwrap();
    assert!(c.true_angle(1).abs() < 1e-6);
    let reached = c.axes[0].move_to(Degrees(123.4)).await.unwrap();
    assert!(reached.distance(Degrees(123.4)).0 < 0.001 && (c.true_angle(1) - 123.4).abs() < 0.001);
    assert_eq!(c.axes[0].position().await.unwrap(), Some(reached));
    assert!(c.axes[0].health().await.unwrap().warnings.is_empty());
}

#[tokio::test(start_paused = true)]
async fn three_axes_share_the_controller_and_its_error_queue() {
    let mut c = controller();
    for axis in &mut c.axes {
        axis.open().await.unwrap();
        axis.home().await.unwrap();
    }
    c.inject(Esp301Fault::Jam(2, 100.0));
    let [a, b, d] = c.axes.as_mut_slice() else { panic!("three axes") };
    let moves = tokio::join!(a.move_to(Degrees(45.0)), b.move_to(Degrees(300.0)), d.move_to(Degrees(180.0)));
    moves.0.unwrap();
    let error = moves.1.unwrap_err();
    assert_eq!(error.kind, ErrorKind::Broken);
    assert!(error.message.contains("203") || error.message.contains("blocked"), "{error}");
    moves.2.unwrap();
    assert!((c.true_angle(1) - 45.0).abs() < 0.001 && (c.true_angle(3) - 180.0).abs() < 0.001);
    assert_eq!(c.axes[1].position().await.unwrap(), None, "a fault voids the reference");
    c.axes[1].home().await.unwrap();
    c.axes[1].move_to(Degrees(300.0)).await.unwrap();
    assert!((c.true_angle(2) - 300.0).abs() < 0.001);
}

#[tokio::test(start_paused = true)]
async fn targets_outside_the_limits_are_refused_before_a_byte_is_sent() {
    let mut c = homed().await;
    c.port.unplug();
    for target in [-5.1, 365.1, f64::NAN, f64::INFINITY] {
        let error = c.axes[0].move_to(Degrees(target)).await.unwrap_err();
        assert_eq!(error.kind, ErrorKind::Refused);
        assert!(error.message.contains("-5° to 365°"), "{error}");
    }
    assert_eq!(c.axes[0].move_to(Degrees(1.0)).await.unwrap_err().kind, ErrorKind::Lost);
}

#[tokio::test(start_paused = true)]
async fn other_stages_and_units_are_a_wrong_device() {
    let mut c = controller_of(["1001", "7777", "1003"], 921_600);
    let error = c.axes[1].open().await.unwrap_err();
    assert_eq!(error.kind, ErrorKind::WrongDevice);
    assert!(error.message.contains("7777") && error.message.contains("1002"), "{error}");
    c.inject(Esp301Fault::Units(1, 2));
    let error = c.axes[0].open().await.unwrap_err();
    assert_eq!(error.kind, ErrorKind::WrongDevice);
    assert!(error.message.contains("degrees"), "{error}");
    c.inject(Esp301Fault::Unknown(3));
    assert_eq!(c.axes[2].open().await.unwrap_err().kind, ErrorKind::WrongDevice);
}

#[tokio::test(start_paused = true)]
async fn every_single_wire_fault_on_any_exchange_of_a_move_is_survived() {
    let faults = [
        Esp301Fault::Wire(WireFault::Late(Duration::from_millis(1300))),
        Esp301Fault::Wire(WireFault::NoReply),
        Esp301Fault::Wire(WireFault::Cut(3)),
        Esp301Fault::Wire(WireFault::Corrupt(0, 0x01)),
        Esp301Fault::Wire(WireFault::Corrupt(2, 0x04)),
        Esp301Fault::Wire(WireFault::Junk(b"\xff\x00junk".to_vec())),
        Esp301Fault::Wire(WireFault::Previous),
        Esp301Fault::Wire(WireFault::Duplicate),
        Esp301Fault::LostCr,
        Esp301Fault::Glued,
        Esp301Fault::Unsolicited,
    ];
    let mut c = homed().await;
    let mut target = 10.0;
    for fault in faults {
        for before in 0..12 {
            (0..before).for_each(|_| c.inject(Esp301Fault::Wire(WireFault::Pass)));
            c.inject(fault.clone());
            target = if target > 100.0 { 10.0 } else { target + 7.0 };
            let reached = c.axes[0].move_to(Degrees(target)).await;
            let reached = reached.unwrap_or_else(|e| panic!("{fault:?} after {before}: {e}"));
            assert!((c.true_angle(1) - target).abs() < 0.01 && reached.distance(Degrees(target)).0 < 0.01, "{fault:?}");
        }
    }
}

#[tokio::test(start_paused = true)]
async fn a_rest_between_the_phases_is_not_the_end_of_homing() {
    let mut c = controller();
    c.inject(Esp301Fault::HomeGlitch(1));
    c.axes[0].open().await.unwrap();
    c.axes[0].home().await.unwrap();
    assert!(c.true_angle(1).abs() < 1e-6, "{}", c.true_angle(1));
    c.axes[0].move_to(Degrees(5.0)).await.unwrap();
}

#[tokio::test(start_paused = true)]
async fn a_restart_voids_the_reference_at_rest_and_in_a_move() {
    let mut c = homed().await;
    c.axes[0].move_to(Degrees(20.0)).await.unwrap();
    c.inject(Esp301Fault::Restart);
    let error = c.axes[0].move_to(Degrees(40.0)).await.unwrap_err();
    assert_eq!(error.kind, ErrorKind::Broken);
    assert!(error.message.contains("restart"), "{error}");
    assert!((c.true_angle(1) - 20.0).abs() < 0.01, "it did not move");
    assert_eq!(c.axes[0].position().await.unwrap(), None);
    c.axes[0].open().await.unwrap();
    assert_eq!(c.axes[0].position().await.unwrap(), None);
    c.axes[0].home().await.unwrap();
    let port = c.port.clone();
    tokio::spawn(async move {
        tokio::time::sleep(Duration::from_secs(4)).await;
        port.with(|twin| twin.inject(Esp301Fault::Restart, Instant::now()));
    });
    assert_eq!(c.axes[0].move_to(Degrees(90.0)).await.unwrap_err().kind, ErrorKind::Broken);
    assert!((30.0..45.0).contains(&c.true_angle(1)));
    c.axes[0].open().await.unwrap();
    c.axes[0].home().await.unwrap();
    c.inject(Esp301Fault::RestartOnCommand);
    assert_eq!(c.axes[0].move_to(Degrees(0.0)).await.unwrap_err().kind, ErrorKind::Broken, "even where it stands at 0");
}

#[tokio::test(start_paused = true)]
async fn faults_of_the_axis_fail_the_move_with_their_kind() {
    for (fault, kind, word) in [
        (Esp301Fault::Jam(1, 50.0), ErrorKind::Broken, "blocked"),
        (Esp301Fault::MotorOff(1), ErrorKind::Broken, "motor"),
        (Esp301Fault::EmergencyStop(true), ErrorKind::Broken, "emergency"),
        (Esp301Fault::CableInterlock(true), ErrorKind::Broken, "interlock"),
        (Esp301Fault::LimitSwitch(1, true), ErrorKind::Broken, "limit switch"),
        (Esp301Fault::NeverDone(1), ErrorKind::Broken, "still moving"),
    ] {
        let mut c = homed().await;
        c.inject(fault.clone());
        let error = c.axes[0].move_to(Degrees(90.0)).await.unwrap_err();
        assert_eq!(error.kind, kind, "{fault:?}: {error}");
        assert!(error.message.contains(word), "{fault:?}: {error}");
    }
}

#[tokio::test(start_paused = true)]
async fn an_emergency_stop_holds_until_its_button_is_released() {
    let mut c = homed().await;
    c.inject(Esp301Fault::EmergencyStop(true));
    assert_eq!(c.axes[0].home().await.unwrap_err().kind, ErrorKind::Broken);
    c.inject(Esp301Fault::EmergencyStop(false));
    c.axes[0].open().await.unwrap();
    c.axes[0].home().await.unwrap();
    c.axes[0].move_to(Degrees(10.0)).await.unwrap();
}

#[tokio::test(start_paused = true)]
async fn a_wrong_place_is_gone_to_once_more_and_a_hand_is_seen() {
    let mut c = homed().await;
    c.inject(Esp301Fault::Overshoot(1, 0.5));
    c.axes[0].move_to(Degrees(90.0)).await.unwrap();
    assert!((c.true_angle(1) - 90.0).abs() < 0.01);
    c.inject(Esp301Fault::Hand(1, 3.0));
    assert_eq!(c.axes[0].position().await.unwrap(), Some(Degrees(93.0)));
}

#[tokio::test(start_paused = true)]
async fn make_safe_stops_a_moving_axis_and_proves_it() {
    let mut c = homed().await;
    let moved = tokio::time::timeout(Duration::from_secs(4), c.axes[0].move_to(Degrees(180.0))).await;
    assert!(moved.is_err(), "the move was dropped on its way");
    c.axes[0].make_safe().await.unwrap();
    let stands = c.true_angle(1);
    tokio::time::sleep(Duration::from_secs(5)).await;
    assert!((20.0..60.0).contains(&stands) && (c.true_angle(1) - stands).abs() < 1e-9);
    c.axes[0].stop().await.unwrap();
}

#[tokio::test(start_paused = true)]
async fn an_unplugged_adapter_is_lost_and_the_reference_outlives_it() {
    let mut c = homed().await;
    c.port.unplug_for(Duration::from_secs(30));
    assert_eq!(c.axes[0].move_to(Degrees(9.0)).await.unwrap_err().kind, ErrorKind::Lost);
    assert_eq!(c.axes[0].open().await.unwrap_err().kind, ErrorKind::Lost);
    tokio::time::sleep(Duration::from_secs(31)).await;
    c.axes[0].open().await.unwrap();
    c.axes[0].move_to(Degrees(9.0)).await.unwrap();
    assert!((c.true_angle(1) - 9.0).abs() < 0.01, "the motor stayed on");
}
