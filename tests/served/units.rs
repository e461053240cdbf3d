//! The units of `systemd/`: what the service manager reads in them, and what the daemon tells it.

use super::{Daemon, quick_lab};
use crate::common::{root, text};
use goniod::config::instrument::Instrument;
use goniod::config::load::load;
use goniod::front::daemon::heart::RHYTHM;
use goniod::front::daemon::serve::USUAL_SOCKET;
use goniod::front::daemon::worker::STOP_LIMIT;
use goniod_drivers::table::Make;
use std::collections::BTreeSet;
use std::fs;
use std::os::unix::net::UnixDatagram;
use std::path::Path;
use std::process::Command;
use std::time::Duration;

/// Longest exposure that the shipped scans ask for, with its read-out.
const LONGEST_EXPOSURE: Duration = Duration::from_secs(65);

/// Value of a directive of a unit.
fn directive(unit: &str, name: &str) -> String {
    let text = fs::read_to_string(root().join("systemd").join(unit)).unwrap();
    let found = text.lines().find_map(|line| line.strip_prefix(name)?.strip_prefix('='));
    found.unwrap_or_else(|| panic!("{unit} has no {name}")).to_owned()
}

#[test]
fn the_units_are_read_by_systemd_without_a_word() {
    if Command::new("systemd-analyze").arg("--version").output().is_err() {
        eprintln!("\n*** SKIPPED: no systemd-analyze here, so the units are not verified ***\n");
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let names = ["goniod.service", "goniod-safe.service", "goniod-run@.service"];
    for name in names {
        let unit = fs::read_to_string(root().join("systemd").join(name)).unwrap();
        // The program is not installed where the units expect it.
        let unit = unit.replace("/usr/bin/goniod", env!("CARGO_BIN_EXE_goniod"));
        fs::write(folder.path().join(name), unit).unwrap();
    }
    for name in ["goniod.service", "goniod-safe.service", "goniod-run@blind.service"] {
        let mut verify = Command::new("systemd-analyze");
        verify.env("SYSTEMD_UNIT_PATH", format!("{}:", text(folder.path())));
        let said = verify.args(["verify", "--man=no"]).arg(folder.path().join(name)).output().unwrap();
        let err = String::from_utf8_lossy(&said.stderr);
        let ours: Vec<&str> = err.lines().filter(|line| line.contains("goniod")).collect();
        assert!(said.status.success() && ours.is_empty(), "{name}: {err}");
    }
}

#[test]
fn make_install_brings_every_file_that_the_units_name() {
    let folder = tempfile::tempdir().unwrap();
    let mut make = Command::new("make");
    make.arg("-C").arg(root()).args(["install", concat!("PROGRAM=", env!("CARGO_BIN_EXE_goniod"))]);
    let done = make.arg(format!("DESTDIR={}", text(folder.path()))).output().unwrap();
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    let mut named = BTreeSet::new();
    for unit in fs::read_dir(folder.path().join("usr/lib/systemd/system")).unwrap() {
        let unit = fs::read_to_string(unit.unwrap().path()).unwrap();
        let of = |key: &str| -> Vec<String> {
            let lines = unit.lines().filter_map(|line| line.strip_prefix(key));
            lines.map(|line| line.split(' ').next().unwrap().to_owned()).collect()
        };
        named.extend(of("Documentation=file:"));
        named.extend(of("ExecStart="));
    }
    assert!(named.len() >= 3, "{named:?}");
    named.extend(
        ["sysusers.d/goniod.conf", "tmpfiles.d/goniod.conf", "sysctl.d/60-goniod.conf"]
            .map(|f| format!("/usr/lib/{f}")),
    );
    named.insert("/usr/share/goniod/config/instrument.example.toml".to_owned());
    for file in named {
        assert!(folder.path().join(file.trim_start_matches('/')).is_file(), "{file} is not installed");
    }
}

#[cfg(feature = "aravis")]
#[test]
fn the_kernel_is_told_to_grant_the_socket_buffer_that_a_camera_asks_for() {
    let asked = goniod_drivers::devices::aravis::AravisOptions::new("camera", "", "").socket_buffer_bytes;
    let sysctl = fs::read_to_string(root().join("systemd/sysctl.conf")).unwrap();
    let granted = sysctl.lines().find_map(|line| line.strip_prefix("net.core.rmem_max = ")).unwrap();
    assert!(granted.parse::<i32>().unwrap() >= asked, "{granted} for {asked}");
}

#[test]
fn the_units_call_commands_that_there_are_and_wait_long_enough() {
    let lab = quick_lab(false);
    for unit in ["goniod.service", "goniod-safe.service"] {
        let start = directive(unit, "ExecStart");
        let mut words: Vec<&str> = start.split(' ').skip(1).collect();
        words.push("--help");
        assert_eq!(lab.goniod(&words).code, 0, "{start}");
    }
    assert_eq!(directive("goniod.service", "OnFailure"), "goniod-safe.service");
}

/// Seconds of a directive.
fn seconds(unit: &str, name: &str) -> Duration {
    Duration::from_secs(directive(unit, name).parse().unwrap())
}

/// The longest that the safe state of a shipped instrument may take: each device twice within its limit, side by side,
/// each beginning at most a second after the one before it.
fn longest_safe_state() -> Duration {
    let read = |name: &str| {
        let file = root().join("config").join(name);
        let safe = load::<Instrument>(&file, "instrument").unwrap().value.safe_state;
        Duration::from_secs_f64(2.0 * safe.limit_s) + Duration::from_secs(8 + safe.order.len() as u64)
    };
    ["instrument.example.toml", "instrument.sim.toml"].map(read).into_iter().max().unwrap()
}

#[test]
fn the_units_wait_for_what_the_program_may_take_and_begin_it_again() {
    let (daemon, safe) = ("goniod.service", "goniod-safe.service");
    let stop = STOP_LIMIT + longest_safe_state();
    assert!(seconds(daemon, "TimeoutStopSec") >= stop, "stopping well, then the safe state: {stop:?}");
    assert!(seconds("goniod-run@.service", "TimeoutStopSec") >= longest_safe_state() + LONGEST_EXPOSURE);
    assert!(seconds(safe, "TimeoutStartSec") >= longest_safe_state());
    // Three signs of life within the watchdog's time: one that comes late is no death.
    assert!(seconds(daemon, "WatchdogSec") >= RHYTHM * 3);
    assert!(seconds(daemon, "TimeoutStartSec") >= Duration::from_secs(30));
    for (name, value) in [
        ("Type", "notify"),
        ("NotifyAccess", "main"),
        ("Restart", "on-failure"),
        ("KillSignal", "SIGTERM"),
        ("RuntimeDirectory", "goniod"),
        ("StateDirectory", "goniod"),
        ("ReadWritePaths", "/run/lock"),
    ] {
        assert_eq!(directive(daemon, name), value, "{name}");
    }
    assert_eq!(
        Path::new(USUAL_SOCKET),
        Path::new("/run").join(directive(daemon, "RuntimeDirectory")).join("goniod.sock")
    );
    // It must reach the locks and the devices that the daemon reached.
    for name in ["ReadWritePaths", "User", "Group", "SupplementaryGroups", "StateDirectory"] {
        assert_eq!(directive(safe, name), directive(daemon, name), "{name}");
    }
    assert_eq!(directive(safe, "Type"), "oneshot");
}

#[test]
fn the_service_manager_is_told_ready_state_and_signs_of_life() {
    let lab = quick_lab(false);
    let path = lab.path("notify.sock");
    let manager = UnixDatagram::bind(&path).unwrap();
    manager.set_read_timeout(Some(Duration::from_secs(120))).unwrap();
    let daemon = Daemon::start_with(&lab, &[("NOTIFY_SOCKET", &text(&path)), ("WATCHDOG_USEC", "600000")]);
    let (mut heard, mut buffer) = (Vec::new(), [0; 4096]);
    while heard.iter().filter(|line: &&String| line.contains("WATCHDOG=1")).count() < 3 {
        let n = manager.recv(&mut buffer).unwrap();
        heard.push(String::from_utf8_lossy(&buffer[..n]).into_owned());
    }
    assert!(heard[0].contains("READY=1"), "{heard:?}");
    assert!(heard.iter().any(|line| line.contains("STATUS=idle")), "{heard:?}");
    assert_eq!(daemon.end(), Some(0));
    let mut last = Vec::new();
    manager.set_read_timeout(Some(Duration::from_millis(50))).unwrap();
    while let Ok(n) = manager.recv(&mut buffer) {
        last.push(String::from_utf8_lossy(&buffer[..n]).into_owned());
    }
    assert!(last.iter().any(|line| line.contains("STOPPING=1")), "{last:?}");
}

/// Lines of the udev rules that give a device to a group.
fn rules() -> String {
    fs::read_to_string(root().join("systemd/70-goniod.rules")).unwrap()
}

#[test]
fn the_udev_rules_open_every_usb_device_of_the_table_to_the_daemon() {
    let rules = rules();
    let mut devices = 0;
    for driver in goniod_drivers::table::DRIVERS {
        let ids = goniod_drivers::table::usb_ids(driver.name);
        let on_usb = matches!(driver.make, Make::UsbLightMonitor(_) | Make::Spectrometer(_));
        assert_eq!(!ids.is_empty(), on_usb, "{} and table::usb_ids", driver.name);
        for (vendor, product) in ids {
            let ids = format!("ATTR{{idVendor}}==\"{vendor:04x}\", ATTR{{idProduct}}==\"{product:04x}\"");
            let line = rules.lines().find(|line| line.starts_with(&ids));
            let line = line.unwrap_or_else(|| panic!("no rule for {vendor:04x}:{product:04x} of {}", driver.name));
            assert!(line.contains("GROUP=\"goniophot\"") && line.contains("MODE=\"0660\""), "{line}");
            devices += 1;
        }
    }
    assert_eq!(rules.matches("ATTR{idVendor}==").count(), devices, "a rule for a device that no driver speaks to");
    assert!(rules.contains("ENV{ID_USB_INTERFACES}==\"*:ef05*\""), "USB3 Vision cameras");
    assert!(rules.contains("KERNEL==\"ttyUSB[0-9]*|ttyACM[0-9]*\", GROUP=\"dialout\""), "serial adapters");
}

#[test]
fn the_daemon_belongs_to_every_group_that_the_rules_name() {
    let rules = rules();
    let named: BTreeSet<&str> = rules.split("GROUP=\"").skip(1).filter_map(|rest| rest.split('"').next()).collect();
    assert!(named.contains("goniophot") && named.contains("dialout"), "{named:?}");
    for unit in ["goniod.service", "goniod-safe.service", "goniod-run@.service"] {
        let groups = directive(unit, "SupplementaryGroups");
        for group in named.iter().chain(&["video"]) {
            assert!(groups.split(' ').any(|g| g == *group), "{unit} is not in {group}");
        }
    }
    let account = fs::read_to_string(root().join("systemd/sysusers.conf")).unwrap();
    assert!(account.contains("g goniophot"), "a group of our own is made where the account is");
}

/// Every line of the rules is made of matches and assignments that udev knows, and every jump has its label.
#[test]
fn the_udev_rules_are_read_by_udev_without_a_word() {
    let path = root().join("systemd/70-goniod.rules");
    match Command::new("udevadm").arg("verify").arg(&path).output() {
        Ok(said) if !String::from_utf8_lossy(&said.stderr).contains("Unknown command") => {
            assert!(said.status.success(), "{}", String::from_utf8_lossy(&said.stderr));
        }
        _ => eprintln!("\n*** SKIPPED: no `udevadm verify` here, so the udev rules are not verified by udev ***\n"),
    }
    let known = ["SUBSYSTEM", "KERNEL", "ACTION", "GROUP", "MODE", "GOTO", "LABEL", "ENV", "ATTR"];
    for line in rules().lines().filter(|line| !line.is_empty() && !line.starts_with('#')) {
        for word in line.split(", ") {
            let key = word.split(['=', '!', '{']).next().unwrap();
            assert!(known.contains(&key) && word.matches('"').count() == 2, "{word} in {line}");
        }
    }
    assert!(rules().contains("LABEL=\"goniod_end\""));
}
