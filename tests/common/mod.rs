//! A lab for tests: a copy of the shipped configuration in a temporary folder, the program run as an operator runs it.
#![allow(dead_code, clippy::unwrap_used, clippy::expect_used)]

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// A temporary folder with `config/` and room for runs.
pub struct Lab {
    folder: tempfile::TempDir,
}

/// What a command said.
pub struct Said {
    pub code: i32,
    pub out: String,
    pub err: String,
}

/// Edits of the shipped files that make the colour camera a sixteenth of its pixels (same optics, four times the
/// angle a pixel): frames render and reduce in milliseconds.
const SMALL: [(&str, &str); 5] = [
    ("width_px = 1392", "width_px = 352"),
    ("height_px = 1040", "height_px = 272"),
    ("centre_x_px = 695.5", "centre_x_px = 175.5"),
    ("centre_y_px = 527.5", "centre_y_px = 143.5"),
    ("deg_per_px = 0.1886", "deg_per_px = 0.7544"),
];

// === impl Lab ===

impl Lab {
    /// The shipped configuration.
    pub fn shipped() -> Lab {
        let folder = tempfile::tempdir().unwrap();
        copy(&root().join("config"), &folder.path().join("config"));
        Lab { folder }
    }

    /// The shipped configuration with a small colour camera.
    pub fn small() -> Lab {
        let lab = Lab::shipped();
        for file in ["instrument.sim.toml", "sim/bench.toml", "calibration/ccd.sim.toml"] {
            lab.edit(file, &SMALL.map(|(a, b)| (a, b)), false);
        }
        lab
    }

    /// Takes `restart_s` from bench and instrument: the cameras run free, and `frames` frames after each change of the
    /// exposure still have the one before.
    pub fn free_running(&self, frames: u32) {
        let (latency, discard) = (format!("latency_frames = {frames}"), format!("discard_frames = {frames}"));
        for restart in ["restart_s = 0.1\n", "restart_s = 0.05\n"] {
            self.edit("sim/bench.toml", &[(restart, "")], true);
            self.edit("instrument.sim.toml", &[(restart, "")], true);
        }
        for was in [2, 1] {
            self.edit("sim/bench.toml", &[(&format!("latency_frames = {was}\n"), &format!("{latency}\n"))], true);
            self.edit("instrument.sim.toml", &[(&format!("discard_frames = {was}\n"), &format!("{discard}\n"))], true);
        }
    }

    /// Path inside the lab.
    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// The instrument file.
    pub fn instrument(&self) -> PathBuf {
        self.path("config/instrument.sim.toml")
    }

    /// Replaces text in a file of `config/`; with `all`, every pair must occur.
    pub fn edit(&self, file: &str, pairs: &[(&str, &str)], all: bool) {
        let path = self.path("config").join(file);
        let mut text = fs::read_to_string(&path).unwrap();
        for (from, to) in pairs {
            assert!(!all || text.contains(from), "{file} does not contain `{from}`");
            text = text.replace(from, to);
        }
        fs::write(&path, text).unwrap();
    }

    /// Puts a light monitor into the instrument, and a table of interlocks with these lines.
    pub fn add_light(&self, interlocks: &str) {
        let monitor = "[light_monitor]\ndriver = \"newport-1830c\"\nport = \"sim:light-monitor\"\nwavelength_nm = 550.0\naverage = 4\n";
        let tables = format!("\n{monitor}\n[interlocks]\n{interlocks}\n\n[camera.ccd]");
        self.edit("instrument.sim.toml", &[("\n[camera.ccd]", &tables)], true);
    }

    /// Writes a scan file into `config/scans/` and gives its path.
    pub fn scan(&self, name: &str, text: &str) -> PathBuf {
        let path = self.path("config/scans").join(name);
        fs::write(&path, text).unwrap();
        path
    }

    /// Runs `goniod` with these arguments, in the lab's folder.
    pub fn goniod(&self, args: &[&str]) -> Said {
        let output = self.command(args).output().unwrap();
        Said::of(output)
    }

    /// The command, for tests that must do more than wait for its end.
    pub fn command(&self, args: &[&str]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_goniod"));
        command.args(args).current_dir(self.folder.path()).env_remove("GONIOD_INSTRUMENT");
        command
    }

    /// Rehearses a scan into `runs` and gives the run directory.
    pub fn rehearse(&self, scan: &Path, runs: &str, more: &[&str]) -> PathBuf {
        let (scan, instrument, runs) = (text(scan), text(&self.instrument()), text(&self.path(runs)));
        let mut args = vec!["rehearse", &scan, "--instrument", &instrument, "--runs", &runs, "--json"];
        args.extend(more);
        let said = self.goniod(&args);
        assert_eq!(said.code, 0, "{}\n{}", said.out, said.err);
        let document: serde_json::Value = serde_json::from_str(&said.out).unwrap();
        self.folder.path().join(document["run"].as_str().unwrap())
    }
}

// === impl Said ===

impl Said {
    fn of(output: Output) -> Said {
        Said {
            code: output.status.code().unwrap_or(-1),
            out: String::from_utf8_lossy(&output.stdout).into_owned(),
            err: String::from_utf8_lossy(&output.stderr).into_owned(),
        }
    }

    /// The JSON document of a command that was run with `--json`.
    pub fn json(&self) -> serde_json::Value {
        serde_json::from_str(&self.out).unwrap_or_else(|e| panic!("{e}: {}\n{}", self.out, self.err))
    }
}

/// The root of the repository.
pub fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// A path as text.
pub fn text(path: &Path) -> String {
    path.to_str().unwrap().to_owned()
}

fn copy(from: &Path, to: &Path) {
    fs::create_dir_all(to).unwrap();
    for entry in fs::read_dir(from).unwrap().flatten() {
        let target = to.join(entry.file_name());
        if entry.path().is_dir() {
            copy(&entry.path(), &target);
        } else {
            fs::copy(entry.path(), target).unwrap();
        }
    }
}
