//! The Zaber driver against the chain's twin.

use super::{Bench, bench, bench_of};
use goniod_drivers::clock::Clock;
use goniod_drivers::contract::RotaryAxis;
use goniod_drivers::error::ErrorKind;
use goniod_drivers::transport::Connector;
use goniod_drivers::units::Degrees;
use goniod_sim::firmware::WireFault;
use goniod_sim::firmware::zaber::ZaberFault;
use goniod_sim::pose::PoseSource;
use goniod_sim::twins::{Fault, TwinsSpec};
use std::time::Duration;
use tokio::time::Instant;

/// A bench whose tilt axis is open and homed.
async fn homed() -> Bench {
    let mut bench = bench();
    bench.axes[0].open().await.unwrap();
    bench.axes[0].home().await.unwrap();
    bench
}

fn inject(bench: &Bench, fault: ZaberFault) {
    bench.twins.inject(Fault::Holder(fault));
}

fn tilt(bench: &Bench) -> f64 {
    bench.twins.pose(Instant::now()).tilt_deg
}

#[tokio::test(start_paused = true)]
async fn the_twin_speaks_the_worked_exchange() {
    let bench = bench();
    let clock = Clock::system();
    let mut link = bench.twins.holder.connector(clock).connect().await.unwrap();
    let mut say = async |request: &str| {
        link.send(format!("{request}\n").as_bytes()).await.unwrap();
        let line = link.line(clock.now() + Duration::from_millis(100)).await.unwrap();
        line.map(|l| String::from_utf8(l).unwrap())
    };
    assert_eq!(say("/1 1 04 get pos:29").await, None, "a wrong checksum is met with silence");
    assert_eq!(say("/1 0 00 set comm.checksum 1").await.unwrap(), "@01 0 00 OK IDLE WR 0:BE");
    assert_eq!(say("/1 0 00 get device.id:14").await.unwrap(), "@01 0 00 OK IDLE WR 50081:F0");
    assert_eq!(say("/1 0 02 get version:77").await.unwrap(), "@01 0 02 OK IDLE WR 7.38:1C");
    assert_eq!(say("/1 1 03 get limit.cycle.dist:3C").await.unwrap(), "@01 1 03 OK IDLE WR 1536000:8B");
    assert_eq!(say("/1 0 10 warnings:75").await.unwrap(), "@01 0 10 OK IDLE WR 01 WR:C3");
    assert_eq!(say("/1 1 05 home:30").await.unwrap(), "@01 1 05 OK BUSY WR 0:93");
    tokio::time::sleep(Duration::from_secs(20)).await;
    assert_eq!(say("/1 1 06:F8").await.unwrap(), "@01 1 06 OK IDLE -- 0:06");
    assert_eq!(say("/1 1 07 move abs 128000:7F").await.unwrap(), "@01 1 07 OK BUSY -- 0:E0");
    assert_eq!(say("/1 1 08 stop:10").await.unwrap(), "@01 1 08 OK BUSY NI 0:A2");
    tokio::time::sleep(Duration::from_secs(20)).await;
    assert_eq!(say("/1 1 09 flip").await.unwrap().split(':').next(), Some("@01 1 09 RJ IDLE NI BADCOMMAND"));
    assert_eq!(say("/1 2 09 home").await.unwrap().split(':').next(), Some("@01 2 09 RJ IDLE NI BADAXIS"));
    let all = say("/").await.unwrap();
    assert!(all.starts_with("@01 0 OK IDLE NI 0"), "{all}");
    let next = link.line(clock.now() + Duration::from_millis(100)).await.unwrap().unwrap();
    assert!(next.starts_with(b"@02 0 OK IDLE WR 0"), "every device answers a broadcast");
}

#[tokio::test(start_paused = true)]
async fn the_twin_answers_what_other_programs_send() {
    let bench = bench();
    let clock = Clock::system();
    let mut link = bench.twins.holder.connector(clock).connect().await.unwrap();
    let mut say = async |request: &str| {
        link.send(format!("{request}\r\n").as_bytes()).await.unwrap();
        let line = link.line(clock.now() + Duration::from_millis(100)).await.unwrap();
        line.map_or(String::new(), |l| String::from_utf8(l).unwrap())
    };
    for (request, reply) in [
        ("/1 1 150 get pos", "@01 1 150 RJ IDLE WR BADMESSAGEID"),
        ("/1 1 -- get resolution", "@01 1 OK IDLE WR 64"),
        ("/1 1 get device.id", "@01 1 RJ IDLE WR DEVICEONLY"),
        ("/1 tools storepos 1 6400", "@01 0 OK IDLE WR 0"),
        ("/1 tools storepos 1", "@01 0 OK IDLE WR 6400"),
        ("/1 tools storepos 17 5", "@01 0 RJ IDLE WR BADDATA"),
        ("/1 storage set name tilt stage", "@01 0 OK IDLE WR 0"),
        ("/1 storage get name", "@01 0 OK IDLE WR tilt stage"),
        ("/1 storage erase name", "@01 0 OK IDLE WR 0"),
        ("/1 storage get name", "@01 0 RJ IDLE WR BADDATA"),
        ("/1 move abs 5 x", "@01 0 RJ IDLE WR BADDATA"),
        ("/1 move sideways 5", "@01 0 RJ IDLE WR BADCOMMAND"),
        ("/1 move index -9223372036854775808", "@01 0 RJ IDLE WR BADDATA"),
        ("/1 0 05 tools echo a\\", ""),
        ("/1 0 05 cont 1 b c", "@01 0 05 OK IDLE WR a b c"),
        ("/1 tools echo 12345678901234567890123456789012345678901234567890123456789012345678901", ""),
        ("/2 set comm.address 7", "@02 0 OK IDLE WR 0"),
        ("/2 get pos", ""),
        ("/7 get comm.address", "@07 0 OK IDLE WR 7"),
        ("/7 renumber 2", "@02 0 OK IDLE WR 0"),
        ("/2 get comm.address", "@02 0 OK IDLE WR 2"),
        ("/1 driver disable", "@01 0 OK IDLE FO 0"),
        ("/1 home", "@01 0 RJ IDLE FO DRIVERDISABLED"),
        ("/1 driver enable", "@01 0 OK IDLE WR 0"),
        // A tenth of the speed that is set, for this move alone.
        ("/1 move rel -12800 15360 205", "@01 0 OK BUSY WR 0"),
        ("/1 get vel", "@01 0 OK BUSY WR -15360"),
    ] {
        assert_eq!(say(request).await, reply, "{request}");
        tokio::time::sleep(Duration::from_millis(400)).await;
    }
}

#[tokio::test(start_paused = true)]
async fn open_home_and_move_find_the_true_angle() {
    let mut bench = bench();
    let identity = bench.axes[0].open().await.unwrap();
    assert_eq!((identity.serial.as_str(), identity.firmware.as_str()), ("1001", "7.38"));
    assert_eq!(bench.axes[0].position().await.unwrap(), None, "unreferenced is unknown");
    assert_eq!(bench.axes[0].move_to(Degrees(30.0)).await.unwrap_err().kind, ErrorKind::Broken);
    bench.axes[0].home().await.unwrap();
    assert!(tilt(&bench).abs() < 1e-6);
    let reached = bench.axes[0].move_to(Degrees(123.4)).await.unwrap();
    assert!(reached.distance(Degrees(123.4)).0 < 0.001 && (tilt(&bench) - 123.4).abs() < 0.001);
    assert!(bench.axes[0].position().await.unwrap().unwrap().distance(reached).0 < 1e-9);
    let health = bench.axes[0].health().await.unwrap();
    assert_eq!((health.warnings.len(), health.temperature_c), (0, Some(34.2)));
}

#[tokio::test(start_paused = true)]
async fn three_axes_share_the_chain() {
    let mut bench = bench();
    for axis in &mut bench.axes {
        axis.open().await.unwrap();
        axis.home().await.unwrap();
    }
    let [a, b, c] = bench.axes.as_mut_slice() else { panic!("three axes") };
    let moves = tokio::join!(a.move_to(Degrees(45.0)), b.move_to(Degrees(300.0)), c.move_to(Degrees(180.0)));
    moves.0.unwrap();
    moves.1.unwrap();
    moves.2.unwrap();
    let pose = bench.twins.pose(Instant::now());
    for (is, should) in [(pose.tilt_deg, 45.0), (pose.spin_deg, 300.0), (pose.changer_deg, 180.0)] {
        assert!((is - should).abs() < 0.001, "{is} {should}");
    }
}

#[tokio::test(start_paused = true)]
async fn ninety_degrees_take_the_time_of_the_trapezoid() {
    let mut bench = homed().await;
    let start = Instant::now();
    bench.axes[0].move_to(Degrees(90.0)).await.unwrap();
    let took = start.elapsed().as_secs_f64();
    // 90 / 10 + 10 / 20 = 9.5 s, then up to one poll, 0.2 s settling and a dozen exchanges of a few milliseconds
    assert!((9.7..9.9).contains(&took), "{took}");
    let past = bench.twins.pose(start + Duration::from_secs(5));
    assert!((past.tilt_deg - 47.5).abs() < 1.0, "the past can be asked: {past:?}");
}

#[tokio::test(start_paused = true)]
async fn targets_outside_the_limits_are_refused_before_a_byte_is_sent() {
    let mut bench = homed().await;
    bench.twins.holder.unplug();
    for target in [-5.1, 365.1, f64::NAN, f64::INFINITY] {
        let error = bench.axes[0].move_to(Degrees(target)).await.unwrap_err();
        assert_eq!(error.kind, ErrorKind::Refused);
        assert!(error.message.contains("-5° to 365°"), "{error}");
    }
    assert_eq!(bench.axes[0].move_to(Degrees(1.0)).await.unwrap_err().kind, ErrorKind::Lost);
}

#[tokio::test(start_paused = true)]
async fn a_wrong_serial_number_is_a_wrong_device() {
    let mut bench = bench_of(TwinsSpec::with_serials("1001", "7777", "1003"));
    bench.axes[0].open().await.unwrap();
    let error = bench.axes[1].open().await.unwrap_err();
    assert_eq!(error.kind, ErrorKind::WrongDevice);
    assert!(error.message.contains("7777") && error.message.contains("1002"), "{error}");
    assert_eq!(bench.axes[1].move_to(Degrees(1.0)).await.unwrap_err().kind, ErrorKind::Lost);
}

#[tokio::test(start_paused = true)]
async fn a_firmware_6_stage_works_without_its_newer_words() {
    let mut spec = TwinsSpec::with_serials("1001", "1002", "1003");
    spec.stages[0].version = "6.28".into();
    let mut bench = bench_of(spec);
    assert_eq!(bench.axes[0].open().await.unwrap().model, "Zaber 50081");
    bench.axes[0].home().await.unwrap();
    bench.axes[0].move_to(Degrees(10.0)).await.unwrap();

    let mut spec = TwinsSpec::with_serials("1001", "1002", "1003");
    spec.stages[0].version = "6.13".into();
    let error = bench_of(spec).axes[0].open().await.unwrap_err();
    assert_eq!(error.kind, ErrorKind::WrongDevice);
    assert!(error.message.contains("6.14"), "{error}");
}

#[tokio::test(start_paused = true)]
async fn every_single_wire_fault_on_any_exchange_of_a_move_is_survived() {
    let faults = [
        ZaberFault::Wire(WireFault::Late(Duration::from_millis(700))),
        ZaberFault::Wire(WireFault::NoReply),
        ZaberFault::Wire(WireFault::Cut(9)),
        ZaberFault::Wire(WireFault::Corrupt(12, 0x04)),
        ZaberFault::Wire(WireFault::Junk(b"\xff\x00junk".to_vec())),
        ZaberFault::Wire(WireFault::Previous),
        ZaberFault::Wire(WireFault::Duplicate),
        ZaberFault::WrongId,
        ZaberFault::WrongLrc,
        ZaberFault::AlertBetween,
        ZaberFault::SplitReply,
        ZaberFault::Again(2),
    ];
    let mut bench = homed().await;
    let mut target = 10.0;
    for fault in faults {
        for before in [0, 1, 2, 3, 4, 5] {
            if let ZaberFault::Wire(_) = fault {
                (0..before).for_each(|_| inject(&bench, ZaberFault::Wire(WireFault::Pass)));
            }
            inject(&bench, fault.clone());
            target = if target > 100.0 { 10.0 } else { target + 7.0 };
            let reached = bench.axes[0].move_to(Degrees(target)).await;
            let reached = reached.unwrap_or_else(|e| panic!("{fault:?} after {before}: {e}"));
            assert!((tilt(&bench) - target).abs() < 0.01 && reached.distance(Degrees(target)).0 < 0.01, "{fault:?}");
        }
    }
}

#[tokio::test(start_paused = true)]
async fn a_lost_reply_to_home_is_not_repeated_blindly() {
    let mut bench = bench();
    bench.axes[0].open().await.unwrap();
    // uptime and warnings pass, the reply to `home` is lost
    [WireFault::Pass, WireFault::Pass, WireFault::NoReply]
        .into_iter()
        .for_each(|f| inject(&bench, ZaberFault::Wire(f)));
    bench.axes[0].home().await.unwrap();
    assert!(tilt(&bench).abs() < 1e-6);
    bench.axes[0].move_to(Degrees(5.0)).await.unwrap();
}

#[tokio::test(start_paused = true)]
async fn a_dead_line_is_a_timeout_and_endless_again_is_busy() {
    let mut bench = homed().await;
    (0..3).for_each(|_| inject(&bench, ZaberFault::Wire(WireFault::NoReply)));
    assert_eq!(bench.axes[0].position().await.unwrap_err().kind, ErrorKind::Timeout);
    inject(&bench, ZaberFault::Again(9));
    assert_eq!(bench.axes[0].position().await.unwrap_err().kind, ErrorKind::Busy);
}

#[tokio::test(start_paused = true)]
async fn a_restart_in_a_move_voids_the_position() {
    let mut bench = homed().await;
    let twins = bench.twins.clone();
    tokio::spawn(async move {
        tokio::time::sleep(Duration::from_secs(4)).await;
        twins.inject(Fault::Holder(ZaberFault::Restart(1)));
    });
    let error = bench.axes[0].move_to(Degrees(90.0)).await.unwrap_err();
    assert_eq!(error.kind, ErrorKind::Broken);
    assert!(error.message.contains("restarted"), "{error}");
    assert!((30.0..45.0).contains(&tilt(&bench)), "the stage stayed where the power left it");
    assert_eq!(bench.axes[0].move_to(Degrees(90.0)).await.unwrap_err().kind, ErrorKind::Lost);
    bench.axes[0].open().await.unwrap();
    assert_eq!(bench.axes[0].position().await.unwrap(), None);
    bench.axes[0].home().await.unwrap();
    bench.axes[0].move_to(Degrees(90.0)).await.unwrap();
    assert!((tilt(&bench) - 90.0).abs() < 0.01);
}

#[tokio::test(start_paused = true)]
async fn a_restart_between_moves_is_seen_by_the_uptime() {
    let mut bench = homed().await;
    bench.axes[0].move_to(Degrees(20.0)).await.unwrap();
    inject(&bench, ZaberFault::RestartOnCommand);
    let error = bench.axes[0].move_to(Degrees(40.0)).await.unwrap_err();
    assert!(error.message.contains("restarted"), "{error}");
    assert!((tilt(&bench) - 20.0).abs() < 0.01, "it did not move");
}

#[tokio::test(start_paused = true)]
async fn a_stall_is_broken_and_homing_is_the_way_back() {
    let mut bench = homed().await;
    inject(&bench, ZaberFault::Stall(1, 50.0));
    let error = bench.axes[0].move_to(Degrees(90.0)).await.unwrap_err();
    assert_eq!(error.kind, ErrorKind::Broken);
    assert!(error.message.contains("FS"), "{error}");
    assert_eq!(bench.axes[0].position().await.unwrap(), None);
    bench.axes[0].home().await.unwrap();
    bench.axes[0].move_to(Degrees(90.0)).await.unwrap();
    assert!((tilt(&bench) - 90.0).abs() < 0.01);
}

#[tokio::test(start_paused = true)]
async fn other_hands_and_hidden_warnings_fail_the_move() {
    for (fault, kind) in [
        (ZaberFault::Displaced(1, 2.0), ErrorKind::Broken),
        (ZaberFault::Knob(1, 2.0), ErrorKind::Busy),
        (ZaberFault::DriverOff(1), ErrorKind::Broken),
        (ZaberFault::HiddenWarning(1, "WL".into()), ErrorKind::Broken),
        (ZaberFault::HiddenWarning(1, "FQ".into()), ErrorKind::Broken),
    ] {
        let mut bench = homed().await;
        inject(&bench, fault.clone());
        let error = bench.axes[0].move_to(Degrees(90.0)).await.unwrap_err();
        assert_eq!(error.kind, kind, "{fault:?}: {error}");
        if fault == ZaberFault::DriverOff(1) {
            bench.axes[0].open().await.unwrap();
            bench.axes[0].move_to(Degrees(90.0)).await.unwrap();
        }
    }
}

#[tokio::test(start_paused = true)]
async fn a_parked_axis_is_unparked_and_moves() {
    let mut bench = homed().await;
    inject(&bench, ZaberFault::Parked(1));
    bench.axes[0].move_to(Degrees(15.0)).await.unwrap();
}

#[tokio::test(start_paused = true)]
async fn a_move_that_never_ends_is_stopped_at_its_deadline() {
    let mut bench = homed().await;
    inject(&bench, ZaberFault::NeverArrives(1));
    let start = Instant::now();
    let error = bench.axes[0].move_to(Degrees(90.0)).await.unwrap_err();
    assert_eq!(error.kind, ErrorKind::Broken);
    assert!(error.message.contains("still moving"), "{error}");
    assert!(start.elapsed() < Duration::from_secs(14));
    bench.axes[0].move_to(Degrees(0.0)).await.unwrap();
}

#[tokio::test(start_paused = true)]
async fn make_safe_stops_a_moving_axis_and_proves_it() {
    let mut bench = homed().await;
    let moved = tokio::time::timeout(Duration::from_secs(4), bench.axes[0].move_to(Degrees(180.0))).await;
    assert!(moved.is_err(), "the move was dropped on its way");
    bench.axes[0].make_safe().await.unwrap();
    let stands = tilt(&bench);
    tokio::time::sleep(Duration::from_secs(5)).await;
    assert!((20.0..60.0).contains(&stands) && (tilt(&bench) - stands).abs() < 1e-9);
    bench.axes[0].stop().await.unwrap();
}

#[tokio::test(start_paused = true)]
async fn an_unplugged_adapter_is_lost_and_open_finds_it_again() {
    let mut bench = homed().await;
    bench.twins.inject(Fault::Unplugged("sim:holder".into(), Duration::from_secs(30)));
    assert_eq!(bench.axes[0].move_to(Degrees(9.0)).await.unwrap_err().kind, ErrorKind::Lost);
    let error = bench.axes[0].open().await.unwrap_err();
    assert_eq!(error.kind, ErrorKind::Lost);
    assert!(error.message.contains("sim:holder"), "{error}");
    tokio::time::sleep(Duration::from_secs(31)).await;
    bench.axes[0].open().await.unwrap();
    bench.axes[0].move_to(Degrees(9.0)).await.unwrap();
    assert!((tilt(&bench) - 9.0).abs() < 0.01, "the reference outlived the adapter");
}

#[tokio::test(start_paused = true)]
async fn an_unknown_axis_name_lists_the_known_ones() {
    let bench = bench();
    let clock = Clock::system();
    let port = bench.twins.connector("sim:holder", clock).unwrap();
    let chain = goniod_drivers::devices::ZaberChain::new(port, vec![super::axis("tilt", 1, "1001")], clock);
    let error = chain.axis("roll").err().unwrap();
    assert!(error.message.contains("there are: tilt"), "{error}");
    assert_eq!(chain.axis("tilt").unwrap().limits(), (Degrees(-5.0), Degrees(365.0)));
}
