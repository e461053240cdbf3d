//! The 1830-C driver against the light monitor's twin, which looks at the bench's lamp.

use super::{Bench, bench};
use goniod_drivers::clock::Clock;
use goniod_drivers::error::ErrorKind;
use goniod_drivers::transport::Connector;
use goniod_drivers::units::Nanometres;
use goniod_sim::firmware::WireFault;
use goniod_sim::firmware::newport_1830c::MonitorFault;
use goniod_sim::truth::lamp::LampFault;
use goniod_sim::twins::Fault;
use std::time::Duration;
use tokio::time::Instant;

async fn open() -> Bench {
    let mut bench = bench();
    bench.light_monitor.open().await.unwrap();
    bench
}

fn inject(bench: &Bench, fault: MonitorFault) {
    bench.twins.inject(Fault::LightMonitor(fault));
}

async fn power_mw(bench: &mut Bench) -> f64 {
    let reading = bench.light_monitor.read().await.unwrap();
    assert!(!reading.saturated && reading.wavelength == Nanometres(550.0));
    reading.power_w * 1e3
}

/// What public clients send, and what they must be able to read.
#[tokio::test(start_paused = true)]
async fn the_twin_speaks_as_public_clients_expect() {
    let bench = bench();
    let clock = Clock::system();
    let mut link = bench.twins.light_monitor.connector(clock).connect().await.unwrap();
    let number = |text: &str| text.parse::<f64>().unwrap();
    for (sent, answer) in [
        ("Z?\n", "0"),
        ("A1\nA?\n", "1"),
        ("A0\nB0\nB?\n", "0"),
        ("E?\n", "0"),
        ("F1\nF?\n", "1"),
        ("G0\nG?\n", "0"),
        ("G1\nG?\n", "1"),
        ("K2\nK?\n", "2"),
        ("L1\nL?\n", "1"),
        ("M128\nM?\n", "128"),
        ("R8\nR?\n", "8"),
        ("R0\nR?\n", "7"),
        ("W0800\nW?\n", "800"),
        ("U3\nU?\n", "3"),
        ("U1\nU?\r\n", "1"),
        ("CS\nQ?\n", "128"),
        ("W1999\nW?\n", "800"),
        ("Q?\n", "129"),
        ("Y7\nQ?\n", "131"),
    ] {
        link.send(sent.as_bytes()).await.unwrap();
        let line = link.line(clock.now() + Duration::from_millis(100)).await.unwrap().unwrap();
        assert_eq!(String::from_utf8(line).unwrap(), answer, "{sent}");
    }
    for (sent, low, high) in
        [("W550\nD?\n", 0.999e-3, 1.001e-3), ("U3\nD?\n", -0.02, 0.02), ("S\nU2\nD?\n", -0.01, 0.01)]
    {
        link.send(sent.as_bytes()).await.unwrap();
        let line = link.line(clock.now() + Duration::from_millis(100)).await.unwrap().unwrap();
        let value = number(&String::from_utf8(line).unwrap());
        assert!(value >= low && value <= high, "{sent} {value}");
    }
    link.send(b"U1\nZ1\nD?\n").await.unwrap();
    let line = link.line(clock.now() + Duration::from_millis(100)).await.unwrap().unwrap();
    assert!(number(&String::from_utf8(line).unwrap()).abs() < 2e-6, "zeroed");
}

#[tokio::test(start_paused = true)]
async fn readings_follow_the_lamp() {
    let mut bench = open().await;
    assert!((power_mw(&mut bench).await - 1.0).abs() < 1e-3);
    bench.twins.inject(Fault::Lamp(LampFault::Jump(-0.03)));
    tokio::time::sleep(Duration::from_secs(1)).await;
    assert!((power_mw(&mut bench).await - 0.97).abs() < 1e-3);
    bench.twins.inject(Fault::Lamp(LampFault::Drift(-0.05)));
    tokio::time::sleep(Duration::from_secs(3600)).await;
    assert!((power_mw(&mut bench).await - 0.97 * 0.95).abs() < 1e-3);
    bench.twins.inject(Fault::Lamp(LampFault::Off));
    tokio::time::sleep(Duration::from_secs(1)).await;
    assert_eq!(power_mw(&mut bench).await, 0.0);
}

#[tokio::test(start_paused = true)]
async fn ten_readings_take_no_more_than_two_seconds_of_the_line() {
    let mut bench = open().await;
    let begun = Instant::now();
    for _ in 0..10 {
        power_mw(&mut bench).await;
    }
    assert!(begun.elapsed() < Duration::from_secs(2), "virtual time {:?}", begun.elapsed());
}

#[tokio::test(start_paused = true)]
async fn too_much_light_is_no_measurement() {
    let mut bench = open().await;
    bench.twins.inject(Fault::Lamp(LampFault::Jump(9.0)));
    tokio::time::sleep(Duration::from_secs(1)).await;
    assert!(bench.light_monitor.read().await.unwrap().saturated);
    assert_eq!(bench.light_monitor.health().await.unwrap().warnings, ["detector saturated"]);
}

#[tokio::test(start_paused = true)]
async fn a_wavelength_is_set_read_back_or_refused() {
    let mut bench = open().await;
    assert_eq!(bench.light_monitor.apply(Nanometres(800.4)).await.unwrap(), Nanometres(800.0));
    let reading = bench.light_monitor.read().await.unwrap();
    assert!((reading.power_w * 1e3 - 550.0 / 800.0).abs() < 1e-3, "the correction is that of 800 nm: {reading:?}");
    for (wavelength, word) in [(1500.0, "refuses the value"), (99.0, "200 to 2000 nm"), (f64::NAN, "200 to 2000 nm")] {
        let error = bench.light_monitor.apply(Nanometres(wavelength)).await.unwrap_err();
        assert_eq!(error.kind, ErrorKind::Refused);
        assert!(error.message.contains(word), "{error}");
    }
}

#[tokio::test(start_paused = true)]
async fn settings_that_somebody_or_a_restart_changed_are_noticed() {
    for fault in [
        MonitorFault::Restart,
        MonitorFault::RestartOnCommand,
        MonitorFault::FrontWavelength(600),
        MonitorFault::FrontUnits(3),
        MonitorFault::Hold,
    ] {
        let mut bench = open().await;
        inject(&bench, fault.clone());
        let error = bench.light_monitor.read().await.unwrap_err();
        assert_eq!(error.kind, ErrorKind::Broken, "{fault:?}: {error}");
        assert!(error.message.contains("open it again"), "{error}");
        assert_eq!(bench.light_monitor.read().await.unwrap_err().kind, ErrorKind::Refused);
        bench.light_monitor.open().await.unwrap();
        power_mw(&mut bench).await;
    }
}

#[tokio::test(start_paused = true)]
async fn every_fault_of_the_wire_ends_in_a_true_reading() {
    let faults = [
        MonitorFault::SettingSwallowed,
        MonitorFault::HalfCommand("W9".into()),
        MonitorFault::Wire(WireFault::NoReply),
        MonitorFault::Wire(WireFault::Late(Duration::from_millis(1200))),
        MonitorFault::Wire(WireFault::Cut(2)),
        MonitorFault::Wire(WireFault::Corrupt(1, 0x01)),
        MonitorFault::Wire(WireFault::Corrupt(3, 0x08)),
        MonitorFault::Wire(WireFault::Previous),
        MonitorFault::Wire(WireFault::Duplicate),
        MonitorFault::Wire(WireFault::Junk(b"1\n".to_vec())),
    ];
    for fault in faults {
        for before in 0..12 {
            let mut bench = open().await;
            (0..before).for_each(|_| inject(&bench, MonitorFault::Wire(WireFault::Pass)));
            inject(&bench, fault.clone());
            let reading = bench.light_monitor.read().await.unwrap_or_else(|e| panic!("{fault:?} after {before}: {e}"));
            assert!((reading.power_w - 1e-3).abs() < 1e-6, "{fault:?} after {before}: {reading:?}");
            inject(&bench, fault.clone());
            bench.light_monitor.apply(Nanometres(600.0)).await.unwrap_or_else(|e| panic!("{fault:?} in apply: {e}"));
            assert_eq!(bench.light_monitor.read().await.unwrap().wavelength, Nanometres(600.0));
        }
    }
}

#[tokio::test(start_paused = true)]
async fn an_echoing_line_is_made_plain_and_an_unplugged_adapter_is_found_again() {
    let mut bench = bench();
    let clock = Clock::system();
    let mut link = bench.twins.light_monitor.connector(clock).connect().await.unwrap();
    link.send(b"E1\n").await.unwrap();
    tokio::time::sleep(Duration::from_millis(50)).await;
    drop(link);
    bench.light_monitor.open().await.unwrap();
    power_mw(&mut bench).await;
    bench.twins.inject(Fault::Unplugged("sim:light-monitor".into(), Duration::from_secs(5)));
    assert_eq!(bench.light_monitor.read().await.unwrap_err().kind, ErrorKind::Lost);
    tokio::time::sleep(Duration::from_secs(6)).await;
    bench.light_monitor.make_safe().await.unwrap();
    power_mw(&mut bench).await;
}
