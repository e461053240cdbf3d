//! Promise: the daemon carries its queue out in order and loses nothing, whatever happens to it, its files or its
//! clients. The real program on the simulated bench, in real time.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stderr)]

mod common;
mod served;

use common::{Lab, text};
use served::{Daemon, http, quick_lab, scan_text};
use std::fs;
use std::io::{Read, Write};
use std::os::unix::fs::PermissionsExt;
use std::os::unix::net::UnixStream;
use std::path::Path;

/// Ids with their states, in the order of the queue.
fn states(daemon: &Daemon) -> Vec<(u64, String)> {
    let list = daemon.json("GET", "/v1/queue", "");
    let entry = |e: &serde_json::Value| (e["id"].as_u64().unwrap(), e["state"].as_str().unwrap().to_owned());
    list["entries"].as_array().unwrap().iter().map(entry).collect()
}

/// Puts a scan that takes a while into the queue, and a short one behind it.
fn add_long_and_next(lab: &Lab, daemon: &Daemon) {
    for (name, long) in [("long", true), ("next", false)] {
        let scan = lab.scan(&format!("{name}.toml"), &scan_text(name, long));
        assert_eq!(daemon.client(&["queue", "add", &text(&scan)]).code, 0);
    }
}

fn all_done(daemon: &Daemon, entries: usize) {
    daemon.until("every entry is done", || {
        let now = states(daemon);
        now.len() == entries && now.iter().all(|(_, state)| state == "done")
    });
}

#[test]
fn a_queue_of_three_is_carried_out_in_order_as_it_was_queued() {
    let lab = quick_lab(false);
    let daemon = Daemon::start(&lab);
    for name in ["one", "two", "three"] {
        let scan = lab.scan(&format!("{name}.toml"), &scan_text(name, false));
        let said = daemon.client(&["queue", "add", &text(&scan)]);
        assert_eq!(said.code, 0, "{}{}", said.out, said.err);
        // What is edited or removed after it was queued changes nothing.
        fs::write(&scan, "this is no scan").unwrap();
    }
    lab.edit("calibration/ccd.sim.toml", &[("serial", "# serial")], true);
    all_done(&daemon, 3);
    let list = daemon.json("GET", "/v1/queue", "");
    let runs: Vec<String> =
        list["entries"].as_array().unwrap().iter().map(|e| e["run"].as_str().unwrap().to_owned()).collect();
    for (run, name) in runs.iter().zip(["one", "two", "three"]) {
        assert!(run.contains(&format!("Z-{name}-")), "{run} is not {name}");
        let told = daemon.json("GET", &format!("/v1/runs/{run}"), "");
        assert_eq!(told["status"]["state"], "completed");
        assert_eq!((&told["status"]["missing"], &told["status"]["planned"]), (&0.into(), &0.into()));
    }
    assert!(runs.is_sorted(), "one after the other: {runs:?}");
    daemon.until("products are made", || {
        let list = daemon.json("GET", "/v1/queue", "");
        list["entries"].as_array().unwrap().iter().all(|e| e["products"]["state"] == "made")
    });
    assert!(daemon.json("GET", "/v1/status", "")["headline"]["lines"][0].is_string());
    for run in &runs {
        let said = lab.goniod(&["verify", &text(&lab.path("runs").join(run))]);
        assert_eq!(said.code, 0, "{}{}", said.out, said.err);
    }
    assert_eq!(daemon.end(), Some(0));
}

#[test]
fn killed_in_mid_run_it_goes_on_with_nothing_lost() {
    let lab = quick_lab(true);
    let daemon = Daemon::start(&lab);
    add_long_and_next(&lab, &daemon);
    let stored = |d: &Daemon| d.json("GET", "/v1/status", "")["run"]["stored"].as_u64().unwrap_or(0);
    daemon.until("a few frames are stored", || stored(&daemon) >= 3);
    let run = daemon.json("GET", "/v1/status", "")["run"]["run"].as_str().unwrap().to_owned();
    daemon.kill();
    lab.edit("instrument.sim.toml", &[("name = \"simulated", "name = \"another simulated")], true);
    let daemon = Daemon::start(&lab);
    all_done(&daemon, 2);
    let list = daemon.json("GET", "/v1/queue", "");
    assert_eq!(list["entries"][0]["run"], *run, "the same run was gone on with");
    assert_eq!(list["entries"][0]["outcome"]["missing"], 0);
    assert_eq!(list["entries"][0]["outcome"]["planned"], 0);
    let runs = fs::read_dir(lab.path("runs")).unwrap().flatten().filter(|e| e.path().join("plan.toml").exists());
    assert_eq!(runs.count(), 2, "no run was begun twice");
    assert_eq!(lab.goniod(&["verify", &text(&lab.path("runs").join(&run))]).code, 0);
    assert_eq!(daemon.end(), Some(0));
}

#[test]
fn a_run_whose_journal_is_damaged_holds_the_queue_and_is_not_begun_again() {
    let lab = quick_lab(true);
    let daemon = Daemon::start(&lab);
    add_long_and_next(&lab, &daemon);
    let run = || daemon.json("GET", "/v1/status", "")["run"].clone();
    daemon.until("a few frames are stored", || run()["stored"].as_u64().unwrap_or(0) >= 3);
    let path = lab.path("runs").join(run()["run"].as_str().unwrap());
    daemon.kill();
    let log = path.join("journal.sqlite-wal");
    let mut bytes = fs::read(&log).unwrap();
    bytes[100] ^= 1;
    fs::write(&log, bytes).unwrap();
    let daemon = Daemon::start(&lab);
    daemon.until("the queue is held", || daemon.json("GET", "/v1/queue", "")["held"].is_string());
    let list = daemon.json("GET", "/v1/queue", "");
    for words in ["journal.sqlite", "damaged", "--accept-loss", "goniod verify"] {
        assert!(list["held"].as_str().unwrap().contains(words), "{words}: {list}");
    }
    assert_eq!(states(&daemon).into_iter().map(|(_, state)| state).collect::<Vec<_>>(), ["failed", "waiting"]);
    let runs = fs::read_dir(lab.path("runs")).unwrap().flatten().filter(|e| e.path().join("plan.toml").exists());
    assert_eq!(runs.count(), 1, "nothing was begun beside it");
    assert_eq!(daemon.end(), Some(0));
}

#[test]
fn a_second_daemon_and_a_run_beside_it_are_refused_with_the_holder() {
    let lab = quick_lab(false);
    let daemon = Daemon::start(&lab);
    let scan = text(&lab.scan("a.toml", &scan_text("a", false)));
    let instrument = text(&lab.instrument());
    let (other, state) = (text(&lab.path("other.sock")), text(&lab.path("other-state")));
    let holder = format!("process {} (goniod serve", daemon.pid());
    for args in [
        vec!["serve", "--instrument", &instrument, "--socket", &other, "--state", &state],
        vec!["run", &scan, "--instrument", &instrument],
    ] {
        let said = lab.goniod(&args);
        assert_eq!(said.code, 10, "{args:?}: {}{}", said.out, said.err);
        assert!(said.err.contains(&holder) && said.err.contains("goniod queue add"), "{}", said.err);
    }
    // Another instrument file with the state folder of the first.
    fs::copy(lab.instrument(), lab.path("config/other.toml")).unwrap();
    let other_file = text(&lab.path("config/other.toml"));
    let said = lab.goniod(&["serve", "--instrument", &other_file, "--socket", &other, "--state", &text(&daemon.state)]);
    assert_eq!(said.code, 10, "{}{}", said.out, said.err);
    assert!(said.err.contains("state folder") && said.err.contains("--state"), "{}", said.err);
    assert_eq!(daemon.end(), Some(0));
}

#[test]
fn verbs_reach_the_run_or_are_refused_with_the_reason() {
    let lab = quick_lab(false);
    let daemon = Daemon::start(&lab);
    let state = |d: &Daemon| d.json("GET", "/v1/status", "")["run"]["state"].as_str().unwrap_or("none").to_owned();
    let refused = daemon.client(&["pause"]);
    assert_eq!(refused.code, 0, "between runs a pause holds the queue: {}", refused.err);
    let scan = text(&lab.scan("long.toml", &scan_text("long", true)));
    assert_eq!(daemon.client(&["queue", "add", &scan]).code, 0);
    assert_eq!(states(&daemon), [(1, "waiting".to_owned())], "held");
    assert_eq!(daemon.client(&["resume"]).code, 0);
    daemon.until("it runs", || state(&daemon) == "running");
    assert_eq!(daemon.client(&["pause"]).code, 0);
    daemon.until("it is paused", || state(&daemon) == "paused");
    let (status, body) = http(&daemon.socket, "POST", "/v1/verbs/pause", "");
    assert_eq!(status, 409, "{body}");
    assert!(body.contains("paused already"), "{body}");
    let said = daemon.client(&["pause"]);
    assert_eq!(said.code, 10, "{}", said.err);
    assert_eq!(daemon.client(&["resume"]).code, 0);
    daemon.until("it runs again", || state(&daemon) == "running");
    assert_eq!(daemon.client(&["pause", "--now"]).code, 0);
    daemon.until("it is paused", || state(&daemon) == "paused");
    assert_eq!(daemon.client(&["stop"]).code, 0);
    daemon.until("it ended", || states(&daemon) == [(1, "done".to_owned())]);
    let list = daemon.json("GET", "/v1/queue", "");
    assert_eq!(list["entries"][0]["outcome"]["ending"], "stopped");
    assert!(list["held"].as_str().unwrap().contains("the operator ended"), "{list}");
    let safe = daemon.client(&["safe"]);
    assert_eq!(safe.code, 0, "{}", safe.err);
    assert!(safe.out.contains("the bench is safe: shutter confirmed"), "{}", safe.out);
    // The run that was stopped is gone on with by its name, and is then held no more.
    let run = list["entries"][0]["run"].as_str().unwrap().to_owned();
    let again = daemon.client(&["resume", &run]);
    assert_eq!(again.code, 0, "{}", again.err);
    assert_eq!(daemon.client(&["resume", &run]).code, 10, "twice");
    assert_eq!(daemon.client(&["queue", "remove", "2"]).code, 0);
    assert_eq!(daemon.client(&["queue", "remove", "2"]).code, 10);
    assert_eq!(states(&daemon)[1].1, "cancelled");
    assert_eq!(daemon.end(), Some(0));
}

#[test]
fn ended_by_sigterm_the_run_is_stopped_well_and_gone_on_with() {
    let lab = quick_lab(true);
    let daemon = Daemon::start(&lab);
    let scan = text(&lab.scan("long.toml", &scan_text("long", true)));
    assert_eq!(daemon.client(&["queue", "add", &scan]).code, 0);
    // A client that listens and one that hangs on without a word keep nobody from ending.
    let mut listener = UnixStream::connect(&daemon.socket).unwrap();
    listener.write_all(b"GET /v1/events HTTP/1.1\r\nhost: x\r\n\r\n").unwrap();
    let _silent = UnixStream::connect(&daemon.socket).unwrap();
    daemon.until("frames are stored", || daemon.json("GET", "/v1/status", "")["run"]["stored"].as_u64() >= Some(2));
    let socket = daemon.socket.clone();
    assert_eq!(daemon.end(), Some(0));
    assert!(!socket.exists());
    let mut heard = String::new();
    listener.read_to_string(&mut heard).unwrap();
    for words in ["event: run-started", "event: frame-stored", "event: stopping", "event: run-ended"] {
        assert!(heard.contains(words), "{words} was not told");
    }
    assert!(heard.trim_end().ends_with("0"), "the stream has its end");
    let daemon = Daemon::start(&lab);
    all_done(&daemon, 1);
    assert_eq!(daemon.end(), Some(0));
}

/// The terminal it was started from is closed.
/// What is asked while an entry is being begun holds: either it goes to the run, or no run begins.
#[test]
fn what_is_asked_while_an_entry_begins_is_heeded() {
    let lab = quick_lab(false);
    let daemon = Daemon::start(&lab);
    let scan = text(&lab.scan("long.toml", &scan_text("long", true)));
    let run = |d: &Daemon| d.json("GET", "/v1/status", "")["run"].clone();
    let body = serde_json::json!({ "scan": scan }).to_string();
    for (verb, ms) in [("stop", 0), ("pause", 10), ("safe", 20), ("stop", 40), ("safe", 60)] {
        let added = daemon.json("POST", "/v1/queue", &body);
        std::thread::sleep(std::time::Duration::from_millis(ms));
        let answer = daemon.json("POST", &format!("/v1/verbs/{verb}"), "");
        let to_run = !answer["run"].is_null();
        std::thread::sleep(std::time::Duration::from_millis(700));
        let now = run(&daemon);
        if to_run {
            daemon.client(&["abort"]);
        } else {
            assert!(now.is_null(), "{verb} after {ms} ms was answered {answer}, and yet {now} is under way");
        }
        daemon.until("no run is under way", || run(&daemon).is_null());
        assert!(daemon.json("GET", "/v1/queue", "")["held"].is_string(), "{verb}");
        let id = added["entry"]["id"].as_u64().unwrap();
        // Taken out, unless its run had begun already.
        let (status, _) = http(&daemon.socket, "DELETE", &format!("/v1/queue/{id}"), "");
        assert!(status == 200 || status == 409, "{status}");
        daemon.json("POST", "/v1/verbs/resume", "");
        if status == 409 {
            daemon.until("it goes on or was ended", || {
                let state = states(&daemon).into_iter().find(|(n, _)| *n == id).unwrap().1;
                state != "running" || !run(&daemon).is_null()
            });
            if !run(&daemon).is_null() {
                daemon.client(&["abort"]);
                daemon.until("it is ended", || run(&daemon).is_null());
                daemon.json("POST", "/v1/verbs/resume", "");
            }
        }
    }
}

#[test]
fn a_hangup_ends_it_as_well_as_sigterm_does() {
    for name in ["HUP", "USR1", "XCPU", "PWR"] {
        let lab = quick_lab(false);
        let daemon = Daemon::start(&lab);
        // A limit of a file's size is no end: a write fails.
        daemon.signal("XFSZ");
        daemon.json("GET", "/v1/status", "");
        daemon.signal(name);
        assert_eq!(daemon.wait(), Some(0), "{name}");
    }
}

#[test]
fn ended_while_it_is_paused_or_ended_twice_it_ends_well_and_goes_on_at_the_next_start() {
    let lab = quick_lab(true);
    let mut daemon = Daemon::start(&lab);
    let scan = text(&lab.scan("long.toml", &scan_text("long", true)));
    assert_eq!(daemon.client(&["queue", "add", &scan]).code, 0);
    let run_of = |d: &Daemon| d.json("GET", "/v1/status", "")["run"].clone();
    for twice in [false, true] {
        daemon.until("it takes exposures", || run_of(&daemon)["state"] == "running" && run_of(&daemon)["stored"] != 0);
        let run = lab.path("runs").join(run_of(&daemon)["run"].as_str().unwrap());
        if twice {
            daemon.ask_to_end();
        } else {
            assert_eq!(daemon.client(&["pause"]).code, 0);
            daemon.until("it is paused", || run_of(&daemon)["state"] == "paused");
        }
        assert_eq!(daemon.end(), Some(0));
        let said = lab.goniod(&["verify", &text(&run)]);
        assert!(said.out.contains("sound, sealed"), "{}{}", said.out, said.err);
        daemon = Daemon::start(&lab);
    }
    all_done(&daemon, 1);
    let list = daemon.json("GET", "/v1/queue", "");
    assert_eq!(
        (&list["entries"][0]["outcome"]["missing"], &list["entries"][0]["outcome"]["planned"]),
        (&0.into(), &0.into())
    );
    assert_eq!(daemon.end(), Some(0));
}

#[test]
fn the_bench_is_made_safe_by_hand_when_the_daemon_is_dead_and_not_behind_its_back() {
    let lab = quick_lab(false);
    let instrument = text(&lab.instrument());
    let direct = || lab.goniod(&["safe", "--direct", "--instrument", &instrument]);
    let daemon = Daemon::start(&lab);
    let said = direct();
    assert_eq!(said.code, 10, "{}{}", said.out, said.err);
    let holder = format!("process {} (goniod serve", daemon.pid());
    assert!(said.err.contains(&holder) && said.err.contains("`goniod safe` asks the daemon"), "{}", said.err);
    assert_eq!(said.err.trim().lines().count(), 1, "one sentence: {}", said.err);
    assert_eq!(daemon.client(&["safe"]).code, 0);
    daemon.kill();
    let said = direct();
    assert_eq!(said.code, 0, "{}{}", said.out, said.err);
    assert!(said.out.contains("confirmed"), "{}", said.out);
}

/// A daemon that is stopped takes connections and says nothing: who asks is told within seconds what to do.
#[test]
fn a_daemon_that_is_stuck_is_found_out_and_what_to_do_is_told() {
    let lab = quick_lab(false);
    let daemon = Daemon::start(&lab);
    daemon.signal("STOP");
    let said = daemon.client(&["safe"]);
    daemon.signal("CONT");
    assert_eq!(said.code, 1, "{}{}", said.out, said.err);
    for words in ["does not answer within 3 s", "systemctl restart goniod", "goniod safe --direct"] {
        assert!(said.err.contains(words), "{words} is not in {}", said.err);
    }
    assert_eq!(daemon.client(&["safe"]).code, 0, "it goes on");
    assert_eq!(daemon.end(), Some(0));
}

/// The events of a run that is over, from the whole journal and from its middle.
fn events_are_told_from_any_place_of_the_journal(daemon: &Daemon, run: &str) {
    let whole = daemon.listen(&format!("?since={run}/-1"), "event: run-ended");
    assert!(whole.contains("event: run-started"), "{whole}");
    let ids: Vec<&str> = whole.lines().filter_map(|l| l.strip_prefix("id: ")).collect();
    let middle = ids[ids.len() / 2];
    let rest = daemon.listen(&format!("?since={middle}"), "event: run-ended");
    let rest_ids: Vec<&str> = rest.lines().filter_map(|l| l.strip_prefix("id: ")).collect();
    assert_eq!(rest_ids, ids[ids.len() / 2 + 1..], "each once, in order");
}

#[test]
fn what_is_no_request_is_refused_and_harms_nobody() {
    let lab = quick_lab(false);
    let daemon = Daemon::start(&lab);
    let ask = |method: &str, path: &str, body: &str| http(&daemon.socket, method, path, body);
    let bad = lab.scan("bad.toml", &scan_text("bad", false).replace("ratio = 8.0", "ratio = -1.0\nwhat = 2"));
    let huge = format!("{{\"scan\": \"{}\"}}", "x".repeat(200_000));
    let scan = |path: &Path| format!("{{\"scan\": \"{}\"}}", text(path));
    for (method, path, body, status, words) in [
        ("GET", "/v2/status", "", 404, "/v2/status"),
        ("PUT", "/v1/queue", "", 405, "method"),
        ("POST", "/v1/queue", "{", 400, "body"),
        ("POST", "/v1/queue", "{}", 422, "`scan`"),
        ("POST", "/v1/queue", "{\"scan\": 3}", 422, "body"),
        ("POST", "/v1/queue", "{\"scan\": \"a.toml\"}", 422, "absolute"),
        ("POST", "/v1/queue", "{\"scan\": \"/none.toml\"}", 422, "there is no such scan file"),
        ("POST", "/v1/queue", "{\"scan\": \"/dev/zero\"}", 422, "no regular file"),
        ("POST", "/v1/queue", "{\"resume\": \"../../etc\"}", 409, "there is no run"),
        ("POST", "/v1/queue", &huge, 413, "body"),
        ("DELETE", "/v1/queue/7", "", 404, "no entry 7"),
        ("DELETE", "/v1/queue/x", "", 400, "path"),
        ("POST", "/v1/verbs/explode", "", 404, "pause-now"),
        ("POST", "/v1/verbs/abort", "", 409, "no run is under way"),
        ("POST", "/v1/verbs/resume", "", 409, "nothing holds the queue"),
        ("GET", "/v1/runs/none", "", 404, "none"),
        ("GET", "/v1/runs/..%2f..%2fetc", "", 404, "etc"),
        ("GET", "/v1/runs?last=many", "", 400, "query"),
        ("GET", "/v1/events?since=yesterday", "", 400, "RUN/NUMBER"),
    ] {
        let (found, answer) = ask(method, path, body);
        assert_eq!(found, status, "{method} {path}: {answer}");
        let answer: serde_json::Value = serde_json::from_str(&answer).unwrap();
        assert!(answer["error"].as_str().unwrap().contains(words), "{method} {path}: {answer}");
    }
    let (status, answer) = ask("POST", "/v1/queue", &scan(&bad));
    let answer: serde_json::Value = serde_json::from_str(&answer).unwrap();
    assert_eq!(status, 422);
    let places: Vec<u64> = answer["issues"].as_array().unwrap().iter().map(|i| i["line"].as_u64().unwrap()).collect();
    assert_eq!(places, [13], "unknown keys are told first: {answer}");
    let said = daemon.client(&["queue", "add", &text(&bad)]);
    assert_eq!(said.code, 3);
    assert!(said.err.contains("bad.toml:13:1: error"), "{}", said.err);
    for garbage in
        [&b"\x16\x03\x01\x00\xff"[..], b"GET\r\n\r\n", b"GET / HTTP/9.9\r\n\r\n", b"POST /v1/queue HTTP/1.1\r\n"]
    {
        let mut stream = UnixStream::connect(&daemon.socket).unwrap();
        stream.write_all(garbage).unwrap();
    }
    assert_eq!(ask("GET", "/v1/status", "").0, 200, "it is still there");
    assert_eq!(daemon.end(), Some(0));
}

#[test]
fn the_socket_is_for_user_and_group_and_the_port_only_shows() {
    let lab = quick_lab(false);
    let port = served::free_port();
    let table = format!("[daemon]\nlisten = \"127.0.0.1:{port}\"\n\n[lamp]");
    lab.edit("instrument.sim.toml", &[("[lamp]", &table)], true);
    let daemon = Daemon::start(&lab);
    assert_eq!(fs::metadata(&daemon.socket).unwrap().permissions().mode() & 0o777, 0o660);
    let (status, page) = served::http_port(port, "GET", "/", "");
    assert_eq!(status, 200);
    assert!(
        page.contains("<html") && !page.contains("http://") && !page.contains("https://"),
        "nothing from elsewhere"
    );
    assert_eq!(served::http_port(port, "GET", "/v1/status", "").0, 200);
    for (method, path) in [("POST", "/v1/queue"), ("POST", "/v1/verbs/stop"), ("DELETE", "/v1/queue/1")] {
        let (status, answer) = served::http_port(port, method, path, "{}");
        assert!([404, 405].contains(&status), "{method} {path}: {status}");
        assert!(answer.contains("error"), "{answer}");
    }
    assert_eq!(daemon.end(), Some(0));
}

#[test]
fn without_a_daemon_one_sentence_says_so() {
    let lab = quick_lab(false);
    let socket = text(&lab.path("none.sock"));
    for args in [&["queue", "list"][..], &["pause"], &["stop"], &["abort"], &["safe"], &["watch"], &["status"]] {
        let mut all = args.to_vec();
        all.extend(["--socket", &socket]);
        let said = lab.goniod(&all);
        assert_eq!(said.code, 9, "{args:?}: {}{}", said.out, said.err);
        assert!(said.err.contains("the daemon does not run") && said.err.contains("goniod serve"), "{}", said.err);
    }
}

#[test]
fn answers_have_the_shape_they_had_and_events_are_told_from_any_place() {
    let lab = quick_lab(false);
    let daemon = Daemon::start(&lab);
    let scan = text(&lab.scan("a.toml", &scan_text("a", false)));
    let added = daemon.json("POST", "/v1/queue", &format!("{{\"scan\": \"{scan}\"}}"));
    all_done(&daemon, 1);
    daemon.until("products are made", || daemon.json("GET", "/v1/status", "")["headline"].is_object());
    let run = daemon.json("GET", "/v1/queue", "")["entries"][0]["run"].as_str().unwrap().to_owned();
    events_are_told_from_any_place_of_the_journal(&daemon, &run);
    let mut shapes = format!("POST /v1/queue\n{}\n", served::shape(&added));
    for path in ["/v1/status", "/v1/queue", "/v1/runs", &format!("/v1/runs/{run}")] {
        let told = daemon.json("GET", path, "");
        shapes += &format!("GET {}\n{}\n", path.replace(&run, "{id}"), served::shape(&told));
    }
    let paused = daemon.json("POST", "/v1/verbs/pause", "");
    shapes += &format!("POST /v1/verbs/{{verb}}\n{}\n", served::shape(&paused));
    let second = daemon.json("POST", "/v1/queue", &format!("{{\"scan\": \"{scan}\"}}"));
    let removed = daemon.json("DELETE", &format!("/v1/queue/{}", second["entry"]["id"]), "");
    shapes += &format!("DELETE /v1/queue/{{id}}\n{}\n", served::shape(&removed));
    let refused: serde_json::Value = serde_json::from_str(&http(&daemon.socket, "GET", "/none", "").1).unwrap();
    shapes += &format!("refusals\n{}\n", served::shape(&refused));
    served::golden("api", &shapes);
    assert_eq!(daemon.end(), Some(0));
}
