//! A daemon for tests: the real program in a lab of its own, asked over its socket by a client that is none of ours.
#![allow(dead_code, clippy::unwrap_used, clippy::expect_used)]

mod managed;
mod units;

use crate::common::{Lab, Said, root, text};
use std::fs;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::Duration;

/// Looks that a condition gets before the test gives up; at ten a second two minutes.
const LOOKS: usize = 1200;

/// A daemon under way.
pub struct Daemon<'a> {
    pub socket: PathBuf,
    pub state: PathBuf,
    lab: &'a Lab,
    child: Child,
}

/// A lab whose bench is quick: small frames, fast axes, no waits.
pub fn quick_lab(auto_resume: bool) -> Lab {
    let lab = Lab::small();
    let quick = [
        ("speed_deg_per_s = 20.0", "speed_deg_per_s = 140.0"),
        ("acceleration_deg_per_s2 = 40.0", "acceleration_deg_per_s2 = 1000.0"),
        ("settle_s = 0.2", "settle_s = 0.0"),
        (
            "runs_dir = \"runs\"",
            if auto_resume { "runs_dir = \"runs\"\nauto_resume = true" } else { "runs_dir = \"runs\"" },
        ),
    ];
    lab.edit("instrument.sim.toml", &quick, true);
    // Two axes and the shutter are enough, and move nobody far.
    let text = fs::read_to_string(lab.instrument()).unwrap();
    let place = |words: &str| text.find(words).unwrap();
    let tables = [&text[..place("[holder.changer]")], &text[place("[filter_wheel]")..place("[reference.reflection]")]];
    let safe = "[reference]\n\n[safe_state]\norder = [\"shutter\", \"cameras\"]\nlimit_s = 20.0\n";
    let text = tables.concat() + safe;
    fs::write(lab.instrument(), text).unwrap();
    lab
}

/// A scan of one band and, with `long`, of four directions with exposures of 1 s; else over within seconds.
pub fn scan_text(name: &str, long: bool) -> String {
    let (directions, longest_s) =
        if long { ("[[0, 180], [10, 180], [20, 180], [30, 180]]", 1.0) } else { ("[[0, 180]]", 0.008) };
    format!(
        r#"name = "{name}"
[sample]
thickness_mm = 4.0
simulated = "../sim/samples/rough_glass.toml"
[incidence]
directions = {directions}
sides = ["transmission-front"]
[bands]
use = ["f1"]
[exposure]
policy = "ladder"
ratio = 8.0
shortest_s = 0.001
longest_s = {longest_s:?}
[dark]
frames = 1
[reference]
mode = "irradiance"
[products]
formats = ["hdf5"]
"#
    )
}

// === impl Daemon ===

impl<'a> Daemon<'a> {
    /// Starts it and waits until it takes requests.
    pub fn start(lab: &'a Lab) -> Daemon<'a> {
        Daemon::start_with(lab, &[])
    }

    /// The same in an environment.
    pub fn start_with(lab: &'a Lab, environment: &[(&str, &str)]) -> Daemon<'a> {
        let (socket, state) = (lab.path("goniod.sock"), lab.path("state"));
        let (s, d, i) = (text(&socket), text(&state), text(&lab.instrument()));
        let args = ["serve", "--instrument", &i, "--socket", &s, "--state", &d];
        let mut child = lab.command(&args).envs(environment.iter().copied()).stdout(Stdio::piped()).spawn().unwrap();
        let mut ready = String::new();
        BufReader::new(child.stdout.take().unwrap()).read_line(&mut ready).unwrap();
        assert!(ready.contains("is served at"), "{ready}");
        Daemon { socket, state, lab, child }
    }

    /// Its process.
    pub fn pid(&self) -> u32 {
        self.child.id()
    }

    /// A request that must succeed, with its document.
    pub fn json(&self, method: &str, path: &str, body: &str) -> serde_json::Value {
        let (status, answer) = http(&self.socket, method, path, body);
        assert!((200..300).contains(&status), "{method} {path}: {status} {answer}");
        serde_json::from_str(&answer).unwrap_or_else(|e| panic!("{e}: {answer}"))
    }

    /// A command of ours that talks to it.
    pub fn client(&self, args: &[&str]) -> Said {
        let socket = text(&self.socket);
        let mut all = args.to_vec();
        all.extend(["--socket", &socket]);
        self.lab.goniod(&all)
    }

    /// Looks again and again.
    pub fn until(&self, what: &str, holds: impl FnMut() -> bool) {
        let queue = || http(&self.socket, "GET", "/v1/queue", "").1;
        assert!(comes_true(holds), "in vain waited until {what}: {}", queue());
    }

    /// Listens to events until these words came.
    pub fn listen(&self, query: &str, last: &str) -> String {
        let mut stream = UnixStream::connect(&self.socket).unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(60))).unwrap();
        write!(stream, "GET /v1/events{query} HTTP/1.1\r\nhost: x\r\n\r\n").unwrap();
        let (mut heard, mut buffer) = (String::new(), [0; 4096]);
        while !heard.contains(last) {
            let n = stream.read(&mut buffer).unwrap();
            assert!(n > 0, "the stream ended: {heard}");
            heard.push_str(&String::from_utf8_lossy(&buffer[..n]));
        }
        // The event's last lines may still be on their way.
        std::thread::sleep(Duration::from_millis(200));
        let n = stream.set_read_timeout(Some(Duration::from_millis(200))).and_then(|()| stream.read(&mut buffer));
        heard.push_str(&String::from_utf8_lossy(&buffer[..n.unwrap_or(0)]));
        heard
    }

    /// Asks it to end, as the service manager does.
    pub fn ask_to_end(&self) {
        signal(self.child.id(), "TERM");
    }

    /// Sends it a signal.
    pub fn signal(&self, name: &str) {
        signal(self.child.id(), name);
    }

    /// Waits for its end and gives its exit code.
    pub fn wait(mut self) -> Option<i32> {
        self.child.wait().unwrap().code()
    }

    /// Asks it to end and gives its exit code.
    pub fn end(mut self) -> Option<i32> {
        signal(self.child.id(), "TERM");
        self.child.wait().unwrap().code()
    }

    /// `kill -9`.
    pub fn kill(mut self) {
        self.child.kill().unwrap();
        self.child.wait().unwrap();
    }
}

impl Drop for Daemon<'_> {
    fn drop(&mut self) {
        // Over already, unless the test failed.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Looks ten times a second, for as long as [`LOOKS`] allow.
fn comes_true(mut holds: impl FnMut() -> bool) -> bool {
    (0..LOOKS).any(|_| {
        let now = holds();
        if !now {
            std::thread::sleep(Duration::from_millis(100));
        }
        now
    })
}

fn signal(pid: u32, name: &str) {
    assert!(Command::new("kill").args([&format!("-{name}"), &pid.to_string()]).status().unwrap().success());
}

/// One request by hand; status and body.
pub fn http(socket: &Path, method: &str, path: &str, body: &str) -> (u16, String) {
    exchange(UnixStream::connect(socket).unwrap(), method, path, body)
}

/// The same on a loopback port.
pub fn http_port(port: u16, method: &str, path: &str, body: &str) -> (u16, String) {
    exchange(TcpStream::connect(("127.0.0.1", port)).unwrap(), method, path, body)
}

fn exchange(mut stream: impl Read + Write, method: &str, path: &str, body: &str) -> (u16, String) {
    let head = format!("{method} {path} HTTP/1.0\r\nhost: x\r\ncontent-type: application/json\r\n");
    // A server that refuses a long body may close before it has read all of it.
    let _ = stream.write_all(format!("{head}content-length: {}\r\n\r\n{body}", body.len()).as_bytes());
    let mut answer = Vec::new();
    let _ = stream.read_to_end(&mut answer);
    let answer = String::from_utf8_lossy(&answer).into_owned();
    let (head, body) = answer.split_once("\r\n\r\n").unwrap_or((&answer, ""));
    let status = head.split(' ').nth(1).and_then(|s| s.parse().ok()).unwrap_or(0);
    (status, body.to_owned())
}

/// A port that nobody has now.
pub fn free_port() -> u16 {
    TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port()
}

/// Keys and kinds of a document, without its values.
pub fn shape(value: &serde_json::Value) -> String {
    let mut lines = std::collections::BTreeSet::new();
    walk(value, "", &mut lines);
    lines.into_iter().map(|line| format!("  {line}\n")).collect()
}

fn walk(value: &serde_json::Value, path: &str, lines: &mut std::collections::BTreeSet<String>) {
    use serde_json::Value;
    match value {
        // What events and states carry is told by their own tests.
        Value::Object(_) if path.ends_with("event") || path.ends_with("detail") => {
            lines.insert(format!("{path}: object"));
        }
        Value::Object(fields) => fields.iter().for_each(|(key, value)| walk(value, &format!("{path}.{key}"), lines)),
        Value::Array(items) if items.is_empty() => {
            lines.insert(format!("{path}[]"));
        }
        Value::Array(items) => items.iter().for_each(|item| walk(item, &format!("{path}[]"), lines)),
        // Of the last events, some have a run and a number and some have none.
        _ if path.starts_with(".last_events[]") => {
            lines.insert(path.to_owned());
        }
        Value::Null => {
            lines.insert(format!("{path}: null"));
        }
        Value::Bool(_) => {
            lines.insert(format!("{path}: bool"));
        }
        Value::Number(_) => {
            lines.insert(format!("{path}: number"));
        }
        Value::String(_) => {
            lines.insert(format!("{path}: text"));
        }
    }
}

/// Compares with a golden file, or writes it where that was asked for.
pub fn golden(name: &str, found: &str) {
    let path = root().join("tests/golden").join(format!("{name}.txt"));
    if std::env::var_os("GONIOD_GOLDEN").is_some_and(|v| v == "write") {
        fs::write(&path, found).unwrap();
    }
    let expected = fs::read_to_string(&path).unwrap_or_default();
    assert_eq!(found, expected, "{} differs", path.display());
}
