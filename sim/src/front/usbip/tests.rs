//! The server against a USB/IP host written byte by byte from the protocol's documentation.

#![allow(clippy::unwrap_used, clippy::expect_used)]

use super::UsbIpServer;
use super::transfers::MOST_WAITING;
use crate::front::usb::{Answer, Descriptors, SetupPacket, Speed, UsbTwin};
use std::io::{Read, Write};
use std::net::TcpStream;
use std::sync::{Arc, Mutex};
use std::time::Duration;
use tokio::time::Instant;

/// Echoes what is written to 0x02 on 0x82; 0x01 halts; vendor request 7 gives five bytes, 9 is unknown.
#[derive(Default)]
struct Echo {
    held: Vec<u8>,
    calls: Vec<&'static str>,
}

impl UsbTwin for Echo {
    fn descriptors(&self) -> Descriptors {
        let device = vec![18, 1, 0, 2, 0, 0, 0, 64, 0x57, 0x24, 0x02, 0x10, 0x34, 0x12, 1, 2, 3, 1];
        let mut configuration = vec![9, 2, 39, 0, 1, 1, 0, 0xc0, 50, 9, 4, 0, 0, 3, 0xff, 1, 2, 0];
        for endpoint in [0x02, 0x82, 0x01] {
            configuration.extend([7, 5, endpoint, 2, 64, 0, 0]);
        }
        let strings = ["Maker", "Echo", "SN7"].map(str::to_owned).into();
        Descriptors { device, configuration, strings, speed: Speed::High }
    }

    fn control(&mut self, setup: SetupPacket, bytes: &[u8], _: Instant) -> Answer {
        match setup.request {
            7 => Answer::Data(b"seven".to_vec()),
            8 => {
                self.held = bytes.to_vec();
                Answer::Data(Vec::new())
            }
            _ => Answer::Stall,
        }
    }

    fn bulk_out(&mut self, endpoint: u8, bytes: &[u8], _: Instant) -> Answer {
        if endpoint == 1 {
            return Answer::Stall;
        }
        self.held.extend(bytes);
        Answer::Data(Vec::new())
    }

    fn bulk_in(&mut self, _: u8, length: usize, _: Instant) -> Answer {
        if self.held == b"babble" {
            return Answer::Data(vec![0; length + 1]);
        }
        if self.held.is_empty() {
            return Answer::Nak;
        }
        let n = length.min(self.held.len());
        Answer::Data(self.held.drain(..n).collect())
    }

    fn clear_halt(&mut self, _: u8, _: Instant) {
        self.calls.push("clear");
    }

    fn reset(&mut self, _: Instant) {
        self.held.clear();
        self.calls.push("reset");
    }

    fn due(&self) -> Option<Instant> {
        None
    }
}

/// A host with one connection.
struct Host {
    stream: TcpStream,
    seqnum: u32,
}

/// An answer of the second stage.
#[derive(Debug, PartialEq, Eq)]
struct Reply {
    command: u32,
    seqnum: u32,
    status: i32,
    moved: usize,
    bytes: Vec<u8>,
}

impl Host {
    fn connect(server: &UsbIpServer) -> Host {
        let stream = TcpStream::connect(server.address()).unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(10))).unwrap();
        Host { stream, seqnum: 0 }
    }

    fn bytes(&mut self, n: usize) -> Vec<u8> {
        let mut bytes = vec![0; n];
        self.stream.read_exact(&mut bytes).unwrap();
        bytes
    }

    /// Status of the import and, where it is zero, the device record.
    fn import(&mut self, busid: &str) -> (u32, Vec<u8>) {
        let mut request = vec![0x01, 0x11, 0x80, 0x03, 0, 0, 0, 0];
        request.extend(busid.bytes());
        request.resize(40, 0);
        self.stream.write_all(&request).unwrap();
        let head = self.bytes(8);
        assert_eq!(head[..4], [0x01, 0x11, 0x00, 0x03]);
        let status = u32::from_be_bytes(head[4..].try_into().unwrap());
        (status, if status == 0 { self.bytes(312) } else { Vec::new() })
    }

    fn attach(server: &UsbIpServer, busid: &str) -> Host {
        let mut host = Host::connect(server);
        assert_eq!(host.import(busid).0, 0);
        host
    }

    /// Sends a transfer and gives its number; `endpoint` with the top bit for IN.
    fn submit(&mut self, endpoint: u8, setup: [u8; 8], length: usize, out: &[u8]) -> u32 {
        self.seqnum += 1;
        let mut header = Vec::new();
        let words =
            [1, self.seqnum, 0x10002, u32::from(endpoint >> 7), u32::from(endpoint & 15), 0, length as u32, 0, 0, 0];
        words.iter().for_each(|w| header.extend(w.to_be_bytes()));
        header.extend(setup);
        self.stream.write_all(&header).unwrap();
        self.stream.write_all(out).unwrap();
        self.seqnum
    }

    fn unlink(&mut self, victim: u32) -> u32 {
        self.seqnum += 1;
        let mut header = Vec::new();
        [2, self.seqnum, 0x10002, 0, 0, victim].iter().for_each(|w: &u32| header.extend(w.to_be_bytes()));
        header.resize(48, 0);
        self.stream.write_all(&header).unwrap();
        self.seqnum
    }

    /// The next answer; `input` when it is one to an IN transfer.
    fn reply(&mut self, input: bool) -> Reply {
        let head = self.bytes(48);
        let word = |at: usize| u32::from_be_bytes(head[at..at + 4].try_into().unwrap());
        let (command, moved) = (word(0), word(24) as usize);
        let bytes = if command == 3 && input { self.bytes(moved) } else { Vec::new() };
        Reply { command, seqnum: word(4), status: word(20) as i32, moved, bytes }
    }

    fn control_in(&mut self, setup: [u8; 8]) -> Reply {
        self.submit(0x80, setup, usize::from(u16::from_le_bytes([setup[6], setup[7]])), &[]);
        self.reply(true)
    }

    fn is_dropped(&mut self) -> bool {
        matches!(self.stream.read(&mut [0; 8]), Ok(0) | Err(_))
    }
}

fn bench() -> (UsbIpServer, Arc<Mutex<Echo>>) {
    let server = UsbIpServer::start("127.0.0.1:0").unwrap();
    let twin = Arc::new(Mutex::new(Echo::default()));
    server.plug("1-1", Arc::clone(&twin));
    (server, twin)
}

#[test]
fn the_list_names_every_device_with_its_interfaces() {
    let (server, _) = bench();
    server.plug("1-2", Arc::new(Mutex::new(Echo::default())));
    let mut host = Host::connect(&server);
    host.stream.write_all(&[0x01, 0x11, 0x80, 0x05, 0, 0, 0, 0]).unwrap();
    assert_eq!(host.bytes(12), [0x01, 0x11, 0, 5, 0, 0, 0, 0, 0, 0, 0, 2]);
    let record = host.bytes(316);
    assert_eq!(&record[256..260], b"1-1\0");
    assert_eq!(record[296..300], [0, 0, 0, 3], "high speed");
    assert_eq!(record[300..306], [0x24, 0x57, 0x10, 0x02, 0x12, 0x34], "ids are big-endian here");
    assert_eq!(record[306..312], [0, 0, 0, 1, 1, 1]);
    assert_eq!(record[312..], [0xff, 1, 2, 0], "class of the interface");
    assert_eq!(&host.bytes(316)[256..260], b"1-2\0");
    assert_eq!(host.import("1-2").0, 0, "the same connection may import");
}

#[test]
fn an_import_is_refused_for_an_unknown_device_and_for_one_that_is_taken() {
    let (server, _) = bench();
    assert_eq!(Host::connect(&server).import("9-9").0, 4);
    let first = Host::attach(&server, "1-1");
    assert_eq!(Host::connect(&server).import("1-1").0, 2);
    drop(first);
    while server.is_imported("1-1") {
        std::thread::yield_now();
    }
    assert_eq!(Host::connect(&server).import("1-1").0, 0, "free again after the host has gone");
}

#[test]
fn standard_requests_are_answered_from_the_descriptors() {
    let (server, twin) = bench();
    let mut host = Host::attach(&server, "1-1");
    let device = host.control_in([0x80, 6, 0, 1, 0, 0, 8, 0]);
    assert_eq!((device.status, device.bytes.as_slice()), (0, &[18, 1, 0, 2, 0, 0, 0, 64][..]), "cut to wLength");
    assert_eq!(host.control_in([0x80, 6, 0, 2, 0, 0, 0xff, 0]).bytes.len(), 39);
    assert_eq!(host.control_in([0x80, 6, 0, 3, 0, 0, 0xff, 0]).bytes, [4, 3, 9, 4]);
    assert_eq!(host.control_in([0x80, 6, 3, 3, 9, 4, 0xff, 0]).bytes, [8, 3, b'S', 0, b'N', 0, b'7', 0]);
    assert_eq!(host.control_in([0x80, 6, 4, 3, 9, 4, 0xff, 0]).status, -32, "no fourth string");
    assert_eq!(host.control_in([0x80, 6, 0, 6, 0, 0, 10, 0]).bytes, [10, 6, 0, 2, 0, 0, 0, 64, 1, 0]);
    assert_eq!(host.control_in([0x80, 8, 0, 0, 0, 0, 1, 0]).bytes, [0], "not configured yet");
    host.submit(0, [0, 9, 1, 0, 0, 0, 0, 0], 0, &[]);
    assert_eq!(host.reply(false).status, 0);
    assert_eq!(host.control_in([0x80, 8, 0, 0, 0, 0, 1, 0]).bytes, [1]);
    host.submit(0, [0, 9, 2, 0, 0, 0, 0, 0], 0, &[]);
    assert_eq!(host.reply(false).status, -32, "there is no configuration 2");
    host.submit(0, [1, 11, 0, 0, 0, 0, 0, 0], 0, &[]);
    assert_eq!(host.reply(false).status, 0);
    host.submit(0, [1, 11, 1, 0, 0, 0, 0, 0], 0, &[]);
    assert_eq!(host.reply(false).status, -32, "there is no alternate setting 1");
    assert_eq!(host.control_in([0x81, 10, 0, 0, 0, 0, 1, 0]).bytes, [0]);
    assert_eq!(host.control_in([0x80, 0, 0, 0, 0, 0, 2, 0]).bytes, [1, 0], "self-powered");
    assert_eq!(twin.lock().unwrap().calls, ["reset"]);
}

#[test]
fn vendor_requests_reach_the_twin_both_ways() {
    let (server, twin) = bench();
    let mut host = Host::attach(&server, "1-1");
    assert_eq!(host.control_in([0xc0, 7, 0, 0, 0, 0, 3, 0]).bytes, b"sev");
    host.submit(0, [0x40, 8, 0, 0, 0, 0, 4, 0], 4, b"abcd");
    let reply = host.reply(false);
    assert_eq!((reply.status, reply.moved), (0, 4));
    assert_eq!(twin.lock().unwrap().held, b"abcd");
    assert_eq!(host.control_in([0xc0, 9, 0, 0, 0, 0, 3, 0]).status, -32);
    assert_eq!(host.control_in([0xc0, 7, 0, 0, 0, 0, 5, 0]).status, 0, "a refused request halts nothing");
}

#[test]
fn a_transfer_waits_until_the_device_has_something() {
    let (server, _) = bench();
    let mut host = Host::attach(&server, "1-1");
    let first = host.submit(0x82, [0; 8], 4, &[]);
    let second = host.submit(0x82, [0; 8], 64, &[]);
    let out = host.submit(0x02, [0; 8], 6, b"sixsix");
    let (a, b, c) = (host.reply(false), host.reply(true), host.reply(true));
    assert_eq!((a.seqnum, a.status, a.moved), (out, 0, 6), "nothing came before there was something");
    assert_eq!((b.seqnum, b.bytes.as_slice()), (first, &b"sixs"[..]));
    assert_eq!((c.seqnum, c.bytes.as_slice()), (second, &b"ix"[..]));
}

#[test]
fn something_that_happens_to_the_device_ends_a_waiting_transfer() {
    let (server, twin) = bench();
    let mut host = Host::attach(&server, "1-1");
    host.submit(0x82, [0; 8], 64, &[]);
    twin.lock().unwrap().held = b"now".to_vec();
    assert_eq!(host.reply(true).bytes, b"now");
}

#[test]
fn a_transfer_that_is_taken_back_never_ends_and_one_that_has_ended_cannot_be_taken_back() {
    let (server, twin) = bench();
    let mut host = Host::attach(&server, "1-1");
    let waiting = host.submit(0x82, [0; 8], 64, &[]);
    host.unlink(waiting);
    let gone = host.reply(false);
    assert_eq!((gone.command, gone.status), (4, -104));
    twin.lock().unwrap().held = b"later".to_vec();
    let next = host.submit(0x82, [0; 8], 64, &[]);
    assert_eq!(host.reply(true).seqnum, next, "the bytes belong to the transfer that was not taken back");
    host.unlink(next);
    let late = host.reply(false);
    assert_eq!((late.command, late.status), (4, 0));
}

#[test]
fn an_unlink_that_overtakes_its_transfer_waits_for_it() {
    let (server, twin) = bench();
    let mut host = Host::attach(&server, "1-1");
    twin.lock().unwrap().held = b"something".to_vec();
    // Number 1 takes back number 2, which comes after it.
    host.unlink(2);
    let victim = host.submit(0x82, [0; 8], 64, &[]);
    assert_eq!(victim, 2);
    let gone = host.reply(false);
    assert_eq!((gone.command, gone.seqnum, gone.status), (4, 1, -104), "given up once, never ended as well");
    host.unlink(99);
    let never = host.reply(false);
    assert_eq!((never.command, never.status), (4, 0), "a transfer that never comes was not there");
    host.submit(0x82, [0; 8], 64, &[]);
    assert_eq!(host.reply(true).bytes, b"something");
}

#[test]
fn a_halted_endpoint_stays_halted_until_it_is_cleared() {
    let (server, twin) = bench();
    let mut host = Host::attach(&server, "1-1");
    for _ in 0..2 {
        host.submit(0x01, [0; 8], 1, b"x");
        assert_eq!(host.reply(false).status, -32);
    }
    assert_eq!(host.control_in([0x82, 0, 0, 0, 1, 0, 2, 0]).bytes, [1, 0]);
    host.submit(0, [2, 1, 0, 0, 1, 0, 0, 0], 0, &[]);
    assert_eq!(host.reply(false).status, 0);
    assert_eq!(host.control_in([0x82, 0, 0, 0, 1, 0, 2, 0]).bytes, [0, 0]);
    assert_eq!(twin.lock().unwrap().calls, ["clear"]);
    host.submit(0, [2, 3, 0, 0, 0x82, 0, 0, 0], 0, &[]);
    assert_eq!(host.reply(false).status, 0);
    host.submit(0x82, [0; 8], 1, &[]);
    assert_eq!(host.reply(true).status, -32, "the host may halt an endpoint too");
}

#[test]
fn more_than_was_asked_for_is_babble() {
    let (server, twin) = bench();
    let mut host = Host::attach(&server, "1-1");
    twin.lock().unwrap().held = b"babble".to_vec();
    host.submit(0x82, [0; 8], 16, &[]);
    let reply = host.reply(true);
    assert_eq!((reply.status, reply.bytes.len()), (-75, 16));
}

#[test]
fn a_crowd_of_waiting_transfers_is_bounded() {
    let (server, _) = bench();
    let mut host = Host::attach(&server, "1-1");
    for _ in 0..MOST_WAITING {
        host.submit(0x82, [0; 8], 1, &[]);
    }
    let one_more = host.submit(0x82, [0; 8], 1, &[]);
    let reply = host.reply(true);
    assert_eq!((reply.seqnum, reply.status), (one_more, -12));
    assert_eq!(server.tally("1-1").unwrap().refused, 1);
}

#[test]
fn malformed_headers_drop_the_connection_and_leave_the_device_to_the_next_host() {
    let (server, _) = bench();
    let mut host = Host::connect(&server);
    host.stream.write_all(b"GET / HTTP/1.1\r\n").unwrap();
    assert!(host.is_dropped());
    let word = |at: usize, value: u32| {
        let mut header = [0_u8; 48];
        header[3] = 1;
        header[at..at + 4].copy_from_slice(&value.to_be_bytes());
        header
    };
    for header in [word(0, 77), word(12, 2), word(16, 16), word(24, u32::MAX), word(32, 5000)] {
        while server.is_imported("1-1") {
            std::thread::yield_now();
        }
        let mut host = Host::attach(&server, "1-1");
        host.stream.write_all(&header).unwrap();
        assert!(host.is_dropped(), "{header:?}");
    }
}

#[test]
fn isochronous_transfers_are_refused_and_the_stream_stays_in_step() {
    let (server, _) = bench();
    let mut host = Host::attach(&server, "1-1");
    let mut header = vec![0_u8; 48 + 32];
    (header[3], header[7], header[15], header[19], header[35]) = (1, 9, 1, 2, 2);
    host.stream.write_all(&header).unwrap();
    assert_eq!(host.reply(true).status, -71);
    assert_eq!(host.control_in([0xc0, 7, 0, 0, 0, 0, 5, 0]).bytes, b"seven");
}

#[test]
fn a_host_that_is_cut_off_in_mid_header_frees_the_device() {
    let (server, twin) = bench();
    let mut host = Host::attach(&server, "1-1");
    host.submit(0x82, [0; 8], 64, &[]);
    host.stream.write_all(&[0; 20]).unwrap();
    drop(host);
    while server.is_imported("1-1") {
        std::thread::yield_now();
    }
    assert_eq!(twin.lock().unwrap().calls, ["reset"], "what was under way is gone");
    Host::attach(&server, "1-1");
}

#[test]
fn pulling_a_device_out_drops_its_host_and_leaves_the_others() {
    let (server, twin) = bench();
    server.plug("1-2", Arc::new(Mutex::new(Echo::default())));
    let (mut one, mut two) = (Host::attach(&server, "1-1"), Host::attach(&server, "1-2"));
    one.submit(0x82, [0; 8], 64, &[]);
    assert!(server.unplug("1-1") && !server.unplug("1-1"));
    assert!(one.is_dropped());
    assert_eq!(two.control_in([0xc0, 7, 0, 0, 0, 0, 5, 0]).bytes, b"seven");
    assert_eq!(Host::connect(&server).import("1-1").0, 4);
    server.plug("1-1", twin);
    Host::attach(&server, "1-1");
}
