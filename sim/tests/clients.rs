//! Other people's programs drive the twins through pseudo-terminals and USB/IP, as they would the devices.
//!
//! Needs a Python with `tests/peers/requirements.txt` at `.venv/bin/python` (or `$GONIOD_PYTHON`); says SKIPPED loudly else.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stderr)]

use goniod_drivers::clock::Clock;
use goniod_drivers::transport::{Connector, SerialConnector};
use goniod_sim::firmware::usb::oceanoptics::{OceanModel, OceanSpec, OceanTwin};
use goniod_sim::firmware::usb::pm100::{Pm100Spec, Pm100Twin};
use goniod_sim::front::PtyPort;
use goniod_sim::front::usbip::UsbIpServer;
use goniod_sim::twins::{Twins, TwinsSpec};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::{Arc, Mutex};
use std::time::Duration;

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap()
}

/// A Python that has these modules.
fn python(modules: &str) -> Option<PathBuf> {
    let python = std::env::var_os("GONIOD_PYTHON").map_or(root().join(".venv/bin/python"), PathBuf::from);
    let probe = Command::new(&python).args(["-c", &format!("import {modules}")]).output();
    if probe.is_ok_and(|o| o.status.success()) {
        return Some(python);
    }
    eprintln!("\n*** SKIPPED: no Python with {modules} (tests/peers/requirements.txt) at {} ***\n", python.display());
    None
}

/// Every text is part of what a program found.
fn holds(found: &str, parts: &[&str]) {
    parts.iter().for_each(|part| assert!(found.contains(part), "{part}: {found}"));
}

/// Runs a script of `tests/peers` and gives the JSON text of its last line.
async fn ask<A: AsRef<std::ffi::OsStr>>(python: PathBuf, script: &str, arguments: &[A]) -> String {
    let mut command = Command::new(python);
    let scripts = root().join("tests/peers");
    command.env("PYTHONPATH", &scripts).arg("-P").arg(scripts.join(script)).args(arguments);
    let out = tokio::task::spawn_blocking(move || command.output().unwrap()).await.unwrap();
    assert!(out.status.success(), "{script}: {}", String::from_utf8_lossy(&out.stderr));
    String::from_utf8(out.stdout).unwrap().lines().last().unwrap_or_default().to_owned()
}

fn twins(drivers: [&str; 3]) -> Twins {
    twins_of(drivers, 12)
}

fn twins_of(drivers: [&str; 3], places: u8) -> Twins {
    let mut spec = TwinsSpec::with_serials("1001", "1002", "1003").with_drivers(drivers).unwrap();
    spec.wheel.queues_input = true;
    spec.wheel.places = places;
    Twins::new(spec)
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_port_is_found_again_after_closing_and_after_a_replug() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("shutter");
    let twins = twins(["zaber-ascii", "thorlabs-fw212c", "thorlabs-sc10"]);
    let clock = Clock::system();
    let pty = PtyPort::open(&path, &twins.shutter, clock).unwrap();
    let mut connector = SerialConnector::new(pty.path().to_str().unwrap(), 9600, clock);
    let answer = async |connector: &mut SerialConnector| {
        let mut link = connector.connect().await?;
        link.send(b"mode?\r").await?;
        link.prompt(clock.now() + Duration::from_secs(20)).await
    };
    for _ in 0..3 {
        assert_eq!(answer(&mut connector).await.unwrap().unwrap(), b"mode?\r1\r");
    }
    twins.shutter.unplug();
    while path.symlink_metadata().is_ok() {
        clock.sleep(Duration::from_millis(5)).await;
    }
    assert!(answer(&mut connector).await.is_err(), "the name is gone");
    twins.shutter.plug();
    while path.symlink_metadata().is_err() {
        clock.sleep(Duration::from_millis(5)).await;
    }
    assert_eq!(answer(&mut connector).await.unwrap().unwrap(), b"mode?\r1\r");
    drop(pty);
    while path.symlink_metadata().is_ok() {
        clock.sleep(Duration::from_millis(5)).await;
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn pymeasure_drives_the_esp301() {
    let Some(python) = python("pymeasure") else { return };
    let folder = tempfile::tempdir().unwrap();
    let twins = twins(["newport-esp301", "thorlabs-fw212c", "thorlabs-sc10"]);
    let pty = PtyPort::open(folder.path().join("holder"), &twins.holder, Clock::system()).unwrap();
    let found = ask(python, "esp301_pymeasure.py", &[pty.path()]).await;
    for part in [
        r#""before": false, "units": "degree""#,
        r#""home": 0.0, "position": 12.5, "limit": 90.0"#,
        "axis 1 reported the error: MOTOR NOT ENABLED",
        "axis 1 reported the error: POSITIVE SOFTWARE LIMIT DETECTED",
        r#""after": false"#,
    ] {
        assert!(found.contains(part), "{part}: {found}");
    }
    let angle = twins.holder.peek(|t| t.angle_deg(1, tokio::time::Instant::now())).unwrap();
    assert!((angle - 12.5).abs() < 1e-6, "{angle}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_vendors_library_drives_the_zaber_chain() {
    let Some(python) = python("zaber_motion") else { return };
    let folder = tempfile::tempdir().unwrap();
    let twins = twins(["zaber-ascii", "thorlabs-fw212c", "thorlabs-sc10"]);
    let pty = PtyPort::open(folder.path().join("holder"), &twins.holder, Clock::system()).unwrap();
    let found = ask(python, "zaber_vendor.py", &[pty.path()]).await;
    for part in [
        r#""addresses": [1, 2, 3], "homed before": false, "homed": true"#,
        r#""position": 12800.0, "relative": 12000.0, "busy": true"#,
        r#""maxspeed": 153600.0, "set": 150000.0"#,
        r#""serial": "1001", "parked": true, "slower": 6400.0, "note": [113, false], "off": ["FO"]"#,
        r#""renumbered": [[1, 2, 9], 3]"#,
    ] {
        assert!(found.contains(part), "{part}: {found}");
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_terminal_program_drives_wheel_and_shutter() {
    let Some(python) = python("serial") else { return };
    let folder = tempfile::tempdir().unwrap();
    let twins = twins(["zaber-ascii", "thorlabs-fw212c", "thorlabs-sc10"]);
    let clock = Clock::system();
    let wheel = PtyPort::open(folder.path().join("wheel"), &twins.wheel, clock).unwrap();
    let shutter = PtyPort::open(folder.path().join("shutter"), &twins.shutter, clock).unwrap();
    let found = ask(python, "shutter_wheel.py", &[wheel.path(), shutter.path()]).await;
    for part in [r#""place": "pos?\r5\r> ", "reopened": "pos?\r5\r> ""#, r#"["ens\r> ", "ens?\r1\r> "]"#] {
        assert!(found.contains(part), "{part}: {found}");
    }
    assert_eq!(twins.wheel.peek(|t| t.place(clock.now())), Some(5));
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_vendors_older_library_drives_the_zaber_chain() {
    let Some(python) = python("zaber.serial") else { return };
    let folder = tempfile::tempdir().unwrap();
    let twins = twins(["zaber-ascii", "thorlabs-fw212c", "thorlabs-sc10"]);
    let pty = PtyPort::open(folder.path().join("holder"), &twins.holder, Clock::system()).unwrap();
    let found = ask(python, "zaber_old.py", &[pty.path()]).await;
    holds(
        &found,
        &[
            r#""serials": ["1001", "1002", "1003"], "before": "WR", "home": "OK", "after": "--", "position": 10000"#,
            r#""refused": "BADDATA", "status": "BUSY", "unknown": "BADCOMMAND", "echo": "one two", "checksum": "#,
        ],
    );
    assert!(!found.contains(r#""checksum": null"#), "{found}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn labdevices_drives_the_smc100() {
    let Some(python) = python("labdevices.newport, pyvisa_py") else { return };
    let folder = tempfile::tempdir().unwrap();
    let twins = twins(["newport-smc100", "thorlabs-fw212c", "thorlabs-sc10"]);
    let pty = PtyPort::open(folder.path().join("holder"), &twins.holder, Clock::system()).unwrap();
    let found = ask(python, "smc100_labdevices.py", &[pty.path()]).await;
    holds(
        &found,
        &[
            r#""idn": "URS100CC"#,
            r#""state": ["0000", "0A"], "refused": "Execution not allowed in NOT REFERENCED state", "moving": true"#,
            r#""position": 10.0, "speed": 20.0, "error": "@", "beyond": "Displacement out of limits""#,
            r#""reset": ["0000", "0A"]"#,
        ],
    );
    let angle = twins.holder.peek(|t| t.angle_deg(1, tokio::time::Instant::now())).unwrap();
    assert!((angle - 10.0).abs() < 1e-6, "{angle}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn pyvisa_drives_wheel_and_shutter() {
    let Some(python) = python("pyvisa_py") else { return };
    let folder = tempfile::tempdir().unwrap();
    let twins = twins(["zaber-ascii", "thorlabs-fw212c", "thorlabs-sc10"]);
    let clock = Clock::system();
    let wheel = PtyPort::open(folder.path().join("wheel"), &twins.wheel, clock).unwrap();
    let shutter = PtyPort::open(folder.path().join("shutter"), &twins.shutter, clock).unwrap();
    let found = ask(python, "prompt_visa.py", &[wheel.path(), shutter.path()]).await;
    holds(
        &found,
        &[
            r#""*idn?\rTHORLABS FW102C/FW212C Filter Wheel version 1.07\r", "pcount?\r12\r", "speed=1\r", "pos=4\r""#,
            r#""pos?\r4\r", "pos=13\rCommand error CMD_ARG_INVALID\r", "Pos?\rCommand error CMD_NOT_DEFINED\r""#,
            r#""id?\rTHORLABS SC10 VERSION 1.07\r", "mode=3\r", "open=3000\r", "ens\r", "ens?\r1\r", "closed?\r0\r""#,
            r#""single": "closed?\r1\r""#,
        ],
    );
    assert_eq!(twins.wheel.peek(|t| t.place(clock.now())), Some(4));
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn indi_turns_the_optec_wheel() {
    if Command::new("indi_optec_wheel").arg("-h").output().is_err() {
        eprintln!("\n*** SKIPPED: no INDI driver indi_optec_wheel (Debian's indi-bin) ***\n");
        return;
    }
    let Some(python) = python("json") else { return };
    let folder = tempfile::tempdir().unwrap();
    // The driver's buffer is too short for the names of nine.
    let twins = twins_of(["zaber-ascii", "optec-ifw", "thorlabs-sc10"], 8);
    let clock = Clock::system();
    let pty = PtyPort::open(folder.path().join("wheel"), &twins.wheel, clock).unwrap();
    let found = ask(python, "optec_indi.py", &[pty.path()]).await;
    holds(&found, &[r#""slot": "4""#]);
    assert_eq!(twins.wheel.peek(|t| t.place(clock.now())), Some(4), "{found}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn visa_programs_drive_the_power_meter() {
    let Some(python) = python("pyvisa_py, usb, ThorlabsPM100, pymeasure") else { return };
    let server = UsbIpServer::start("127.0.0.1:0").unwrap();
    server.plug("1-1", Arc::new(Mutex::new(Pm100Twin::new(Pm100Spec::new("P0001234")))));
    let found = ask(python, "meter_visa.py", &[server.address().to_string()]).await;
    holds(
        &found,
        &[
            r#""resources": ["USB0::4883::32888::P0001234::0::INSTR"], "idn": "THORLABS,PM100D,P0001234,2.4.0""#,
            r#""parts": 41, "#,
            r#""-113,\"Undefined header\"""#,
            r#""late": "VI_ERROR_TMO", "again": [true, "THORLABS,PM100D,P0001234,2.4.0"]"#,
            r#""thorlabs": [550.0, 25.4, 1, "S120VC", "POW"], "read": 0.00"#,
            r#""pymeasure": ["S120VC", 600.0, 1100.0, "#,
        ],
    );
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn seabreeze_drives_the_spectrometers() {
    let Some(python) = python("usb, seabreeze") else { return };
    let server = UsbIpServer::start("127.0.0.1:0").unwrap();
    for (busid, model, serial) in [
        ("1-1", OceanModel::Usb2000, "USB2G1234"),
        ("1-2", OceanModel::Usb2000Plus, "USB2+H00001"),
        ("1-3", OceanModel::Usb4000, "USB4C00002"),
    ] {
        let twin = OceanTwin::new(OceanSpec::new(model, serial), tokio::time::Instant::now());
        server.plug(busid, Arc::new(Mutex::new(twin)));
    }
    let found = ask(python, "spectrometer_seabreeze.py", &[server.address().to_string()]).await;
    holds(
        &found,
        &[
            r#""USB2000": {"serial": "USB2G1234", "pixels": 2048, "from": 345.679, "brightest": 546"#,
            r#""USB2000PLUS": {"serial": "USB2+H00001", "pixels": 2048, "from": 345.679, "brightest": 546"#,
            r#""USB4000": {"serial": "USB4C00002", "pixels": 3840, "from": 345.679, "brightest": 546"#,
        ],
    );
}
