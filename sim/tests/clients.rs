//! Other people's programs drive the twins through pseudo-terminals, as they would the devices.
//!
//! Needs a Python with `tests/peers/requirements.txt` at `.venv/bin/python` (or `$GONIOD_PYTHON`); says SKIPPED loudly else.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stderr)]

use goniod_drivers::clock::Clock;
use goniod_drivers::transport::{Connector, SerialConnector};
use goniod_sim::front::PtyPort;
use goniod_sim::twins::{Twins, TwinsSpec};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap()
}

fn python(module: &str) -> Option<PathBuf> {
    let python = std::env::var_os("GONIOD_PYTHON").map_or(root().join(".venv/bin/python"), PathBuf::from);
    let probe = Command::new(&python).args(["-c", &format!("import {module}")]).output();
    if probe.is_ok_and(|o| o.status.success()) {
        return Some(python);
    }
    eprintln!("\n*** SKIPPED: no Python with {module} (tests/peers/requirements.txt) at {} ***\n", python.display());
    None
}

/// Runs a script of `tests/peers` and gives the JSON text of its last line.
async fn ask(python: PathBuf, script: &str, ports: &[&Path]) -> String {
    let mut command = Command::new(python);
    command.arg("-P").arg(root().join("tests/peers").join(script)).args(ports);
    let out = tokio::task::spawn_blocking(move || command.output().unwrap()).await.unwrap();
    assert!(out.status.success(), "{script}: {}", String::from_utf8_lossy(&out.stderr));
    String::from_utf8(out.stdout).unwrap().lines().last().unwrap_or_default().to_owned()
}

fn twins(drivers: [&str; 3]) -> Twins {
    let mut spec = TwinsSpec::with_serials("1001", "1002", "1003").with_drivers(drivers).unwrap();
    spec.wheel.queues_input = true;
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
        r#""serial": "1001", "parked": true"#,
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
