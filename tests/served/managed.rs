//! The units under a real systemd, booted in namespaces of its own: killed, hung, given up and stopped.

use super::{comes_true, quick_lab, scan_text};
use crate::common::{Lab, root, text};
use std::fs;
use std::path::PathBuf;
use std::process::{Child, Command, Output, Stdio};

/// Limits of the test instead of those of the unit, so that a hang is over soon, but none that a busy machine breaks.
const WATCHDOG: &str = "[Service]\nWatchdogSec=20\nRestartSec=100ms\n";

/// A machine with nothing but systemd and goniod.
struct Machine {
    boot: Child,
    folder: tempfile::TempDir,
}

// === impl Machine ===

impl Machine {
    /// Boots it; `None` where this machine does not let us.
    fn boot(lab: &Lab) -> Option<Machine> {
        let folder = tempfile::tempdir().unwrap();
        for name in ["layers", "root"] {
            fs::create_dir(folder.path().join(name)).unwrap();
        }
        let (house, config) = (text(root()), text(&lab.path("config")));
        let program = env!("CARGO_BIN_EXE_goniod");
        let install = format!(
            "set -e\nmake -C {house} install DESTDIR=\"$1\" PROGRAM={program}\ncd \"$1\"\n\
             mkdir -p etc/systemd/system/goniod.service.d\n\
             cp -r {config} etc/goniod\nmv etc/goniod/instrument.sim.toml etc/goniod/instrument.toml\n\
             printf '{}' >etc/systemd/system/goniod.service.d/test.conf\n",
            WATCHDOG.replace('\n', "\\n")
        );
        fs::write(folder.path().join("install.sh"), install).unwrap();
        let mut unshare = Command::new("unshare");
        unshare.args(["--pid", "--mount", "--cgroup", "--uts", "--ipc", "--fork", "--kill-child", "sh"]);
        unshare.arg(root().join("tests/served/boot.sh")).arg(folder.path());
        let boot = unshare.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null()).spawn().ok()?;
        let mut machine = Machine { boot, folder };
        // Before systemd is process 1 its own commands say "offline", and do nothing without an error.
        let up = |m: &Machine| {
            matches!(m.says(&["systemctl", "is-system-running"]).as_deref(), Some("running" | "degraded"))
        };
        let settled = comes_true(|| machine.boot.try_wait().unwrap().is_some() || up(&machine));
        (settled && machine.boot.try_wait().unwrap().is_none()).then_some(machine)
    }

    /// Process 1 of the machine, as this one numbers it.
    fn first(&self) -> Option<u32> {
        let pid = self.boot.id();
        let children = fs::read_to_string(format!("/proc/{pid}/task/{pid}/children")).ok()?;
        children.split_whitespace().next()?.parse().ok()
    }

    /// A command in the machine.
    fn run(&self, command: &[&str]) -> Option<Output> {
        let target = self.first()?.to_string();
        let new_root = self.folder.path().join("root");
        let mut enter = Command::new("nsenter");
        enter.args(["-t", &target, "-m", "-p", "-u", "-i", "-C", "chroot"]).arg(new_root).args(command);
        enter.stdin(Stdio::null()).output().ok()
    }

    /// What a command in the machine says; `None` where it says nothing.
    fn says(&self, command: &[&str]) -> Option<String> {
        let out = String::from_utf8_lossy(&self.run(command)?.stdout).trim().to_owned();
        (!out.is_empty()).then_some(out)
    }

    /// A script in the machine whose last command must succeed.
    fn does(&self, script: &str) {
        let done = self.run(&["sh", "-c", script]).unwrap();
        assert!(done.status.success(), "{script}: {}", String::from_utf8_lossy(&done.stderr));
    }

    fn sh(&self, script: &str) -> String {
        self.says(&["sh", "-c", script]).unwrap_or_default()
    }

    /// A property of a unit.
    fn property(&self, unit: &str, name: &str) -> String {
        self.sh(&format!("systemctl show {unit} -p {name} --value"))
    }

    fn until(&self, what: &str, mut holds: impl FnMut(&Machine) -> bool) {
        let status = || self.sh("systemctl status goniod goniod-safe; goniod queue list");
        assert!(comes_true(|| holds(self)), "in vain waited until {what}: {}", status());
    }

    fn signal(&self, name: &str) {
        self.does(&format!("kill {name} $(systemctl show goniod -p MainPID --value)"));
    }

    /// How often the daemon was begun again.
    fn restarts(&self) -> u32 {
        self.property("goniod", "NRestarts").parse().unwrap_or(0)
    }

    /// Exposures stored of the first run.
    fn stored(&self) -> u64 {
        let runs: Vec<PathBuf> = Vec::from_iter(self.sh("ls -d /var/lib/goniod/runs/*").lines().map(PathBuf::from));
        let Some(run) = runs.first() else { return 0 };
        self.sh(&format!("ls {}/frames.zarr/*/ | grep -c '^c\\.'", text(run))).parse().unwrap_or(0)
    }
}

impl Drop for Machine {
    fn drop(&mut self) {
        // Its namespaces end with it, and all that was mounted in them.
        let _ = self.boot.kill();
        let _ = self.boot.wait();
    }
}

#[test]
fn under_a_real_systemd_the_daemon_is_begun_again_given_up_safely_and_stopped_well() {
    let lab = quick_lab(true);
    lab.edit("instrument.sim.toml", &[("runs_dir = \"runs\"", "runs_dir = \"/var/lib/goniod/runs\"")], true);
    lab.scan("night.toml", &scan_text("night", true));
    let Some(machine) = Machine::boot(&lab) else {
        eprintln!(
            "\n*** SKIPPED: no systemd can be booted here (root, namespaces, overlayfs and systemd are needed) ***\n"
        );
        return;
    };
    machine.does(
        "systemd-sysusers; systemd-tmpfiles --create goniod.conf; systemctl daemon-reload; systemctl start goniod",
    );
    let active = |m: &Machine| m.property("goniod", "ActiveState") == "active";
    machine.until("the daemon is ready", active);
    machine.does("goniod queue add /etc/goniod/scans/night.toml");
    machine.until("frames are stored", |m| m.stored() > 0);

    machine.signal("-KILL");
    machine.until("it is begun again", |m| m.restarts() == 1 && active(m));
    machine.until("it goes on", |m| m.property("goniod", "StatusText").contains("-night-"));
    machine.signal("-STOP");
    machine.until("the watchdog has begun it again", |m| m.restarts() == 2 && active(m));
    machine.signal("-KILL");
    machine.until("it is given up", |m| m.property("goniod", "ActiveState") == "failed");
    let safe = |m: &Machine| m.property("goniod-safe", "ExecMainExitTimestampMonotonic") != "0";
    machine.until("the bench was made safe without it", safe);
    assert_eq!(machine.property("goniod-safe", "ExecMainStatus"), "0");

    machine.does("systemctl reset-failed goniod; systemctl start goniod");
    machine.until("it goes on with the run", |m| m.property("goniod", "StatusText").contains("-night-"));
    machine.does("systemctl stop goniod");
    assert_eq!(
        (machine.property("goniod", "Result"), machine.property("goniod", "ExecMainStatus")),
        ("success".into(), "0".into())
    );
    machine.does("systemctl start goniod");
    machine.until("the run is done", |m| m.sh("goniod queue list --json").contains("\"state\": \"done\""));
    let verdict = machine.sh("cd /var/lib/goniod/runs && goniod verify * 2>&1");
    assert!(verdict.contains("sound") && verdict.contains("0 missing + 0 not done"), "{verdict}");
}
