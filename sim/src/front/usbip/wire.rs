//! USB/IP on the wire: headers of both stages, big-endian. Pure.
//!
//! Source: Linux kernel documentation, `usb/usbip_protocol.rst`, protocol version 1.1.1.

use crate::front::usb::{Descriptors, SetupPacket};
use std::io::{self, Read};

/// Protocol version 1.1.1.
pub const VERSION: u16 = 0x0111;
/// Asks for the list of devices.
pub const REQ_DEVLIST: u16 = 0x8005;
/// Asks for one device; the connection then carries its transfers.
pub const REQ_IMPORT: u16 = 0x8003;
/// All is well.
pub const STATUS_OK: u32 = 0;
/// Another host has the device.
pub const STATUS_BUSY: u32 = 2;
/// There is no such device.
pub const STATUS_NO_DEVICE: u32 = 4;

/// Transfer status: the endpoint is halted or the request unknown (-EPIPE).
pub const STALLED: i32 = -32;
/// Transfer status: taken back by the host (-ECONNRESET).
pub const UNLINKED: i32 = -104;
/// Transfer status: more came than was asked for (-EOVERFLOW).
pub const BABBLE: i32 = -75;
/// Transfer status: of a kind that is not carried here, as isochronous ones (-EPROTO).
pub const UNSUPPORTED: i32 = -71;
/// Transfer status: too many transfers wait (-ENOMEM).
pub const CROWDED: i32 = -12;

/// Bytes of a bus id.
const BUSID: usize = 32;
/// Longest transfer accepted.
const LONGEST: u32 = 16 << 20;
/// Most isochronous packets of one transfer that are read past.
const ISO_PACKETS: u32 = 1024;

/// What a host asks before it has a device.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Request {
    /// The list of devices.
    List,
    /// The device with this bus id.
    Import(String),
}

/// One transfer.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Urb {
    /// Number the answer carries.
    pub seqnum: u32,
    /// Endpoint address, with the top bit for IN.
    pub endpoint: u8,
    /// Most bytes of an IN transfer.
    pub length: usize,
    /// Setup packet (endpoint 0).
    pub setup: SetupPacket,
    /// Bytes of an OUT transfer.
    pub bytes: Vec<u8>,
    /// Isochronous.
    pub isochronous: bool,
}

/// What a host asks once it has a device.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Command {
    /// Do a transfer.
    Submit(Urb),
    /// Take a transfer back.
    Unlink {
        /// Number of this command.
        seqnum: u32,
        /// Number of the transfer.
        victim: u32,
    },
}

/// What a host should know of a device before it imports it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Listing {
    /// Bus id (`1-1`).
    pub busid: String,
    /// Number on the bus, from 1.
    pub number: u32,
    /// The device.
    pub descriptors: Descriptors,
}

fn malformed(what: &str) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidData, what.to_owned())
}

fn read<const N: usize>(from: &mut impl Read) -> io::Result<[u8; N]> {
    let mut bytes = [0; N];
    from.read_exact(&mut bytes)?;
    Ok(bytes)
}

fn word(bytes: &[u8], at: usize) -> u32 {
    bytes.get(at..at + 4).and_then(|b| b.try_into().ok()).map_or(0, u32::from_be_bytes)
}

/// Reads a request of the first stage.
///
/// # Errors
/// The stream ended, or says what the protocol does not know.
pub fn read_request(from: &mut impl Read) -> io::Result<Request> {
    let head: [u8; 8] = read(from)?;
    let (version, code) = (u16::from_be_bytes([head[0], head[1]]), u16::from_be_bytes([head[2], head[3]]));
    match (version, code) {
        (VERSION, REQ_DEVLIST) => Ok(Request::List),
        (VERSION, REQ_IMPORT) => {
            let busid: [u8; BUSID] = read(from)?;
            let name = busid.split(|b| *b == 0).next().unwrap_or_default();
            Ok(Request::Import(String::from_utf8_lossy(name).into_owned()))
        }
        _ => Err(malformed("no USB/IP 1.1.1 request")),
    }
}

/// Reads a command of the second stage with all its bytes.
///
/// # Errors
/// The stream ended, or says what the protocol does not know.
pub fn read_command(from: &mut impl Read) -> io::Result<Command> {
    let head: [u8; 48] = read(from)?;
    let (seqnum, direction, endpoint) = (word(&head, 4), word(&head, 12), word(&head, 16));
    match word(&head, 0) {
        1 => {}
        2 => return Ok(Command::Unlink { seqnum, victim: word(&head, 20) }),
        _ => return Err(malformed("no USB/IP command")),
    }
    let (length, packets) = (word(&head, 24), word(&head, 32));
    if direction > 1 || endpoint > 15 || length > LONGEST {
        return Err(malformed("a transfer of impossible direction, endpoint or length"));
    }
    let mut bytes = vec![0; if direction == 0 { length as usize } else { 0 }];
    from.read_exact(&mut bytes)?;
    let isochronous = packets != 0 && packets != u32::MAX;
    if isochronous {
        if packets > ISO_PACKETS {
            return Err(malformed("a transfer of too many packets"));
        }
        from.read_exact(&mut vec![0; packets as usize * 16])?;
    }
    let half = |at: usize| u16::from_le_bytes([head[at], head[at + 1]]);
    let setup =
        SetupPacket { request_type: head[40], request: head[41], value: half(42), index: half(44), length: half(46) };
    let endpoint = endpoint as u8 | (direction as u8) << 7;
    Ok(Command::Submit(Urb { seqnum, endpoint, length: length as usize, setup, bytes, isochronous }))
}

/// Appends the end of a transfer: its status, the number of bytes moved and, for IN, the bytes.
pub fn put_submitted(out: &mut Vec<u8>, seqnum: u32, status: i32, moved: usize, bytes: &[u8]) {
    for value in [3, seqnum, 0, 0, 0, status as u32, moved as u32, 0, 0, 0, 0, 0] {
        out.extend_from_slice(&u32::to_be_bytes(value));
    }
    out.extend_from_slice(bytes);
}

/// Appends the answer to an unlink: whether the transfer was still there.
pub fn put_unlinked(out: &mut Vec<u8>, seqnum: u32, found: bool) {
    let status = if found { UNLINKED } else { 0 };
    for value in [4, seqnum, 0, 0, 0, status as u32, 0, 0, 0, 0, 0, 0] {
        out.extend_from_slice(&u32::to_be_bytes(value));
    }
}

/// The list of devices.
pub fn device_list(devices: &[Listing]) -> Vec<u8> {
    let mut out = reply_head(0x0005, STATUS_OK);
    out.extend_from_slice(&(devices.len() as u32).to_be_bytes());
    for device in devices {
        device.put(&mut out);
        for interface in device.interfaces() {
            out.extend_from_slice(&interface);
        }
    }
    out
}

/// The answer to an import: the device, or why it cannot be had.
pub fn import_reply(answer: Result<&Listing, u32>) -> Vec<u8> {
    match answer {
        Ok(device) => {
            let mut out = reply_head(0x0003, STATUS_OK);
            device.put(&mut out);
            out
        }
        Err(status) => reply_head(0x0003, status),
    }
}

fn reply_head(code: u16, status: u32) -> Vec<u8> {
    let mut out = Vec::with_capacity(512);
    out.extend_from_slice(&VERSION.to_be_bytes());
    out.extend_from_slice(&code.to_be_bytes());
    out.extend_from_slice(&status.to_be_bytes());
    out
}

// === impl Listing ===

impl Listing {
    /// Class, subclass and protocol of each interface (alternate setting 0), and a zero.
    fn interfaces(&self) -> Vec<[u8; 4]> {
        let all = super::standard::parts(&self.descriptors.configuration);
        let first = all.filter(|d| d.get(1) == Some(&4) && d.get(3) == Some(&0));
        first.filter_map(|d| Some([*d.get(5)?, *d.get(6)?, *d.get(7)?, 0])).collect()
    }

    /// The 312 bytes of a device record.
    fn put(&self, out: &mut Vec<u8>) {
        let start = out.len();
        let text = |out: &mut Vec<u8>, text: &str, size: usize| {
            let end = out.len() + size;
            out.extend(text.bytes().take(size - 1));
            out.resize(end, 0);
        };
        text(out, &format!("/sys/devices/goniod-sim/usb1/{}", self.busid), 256);
        text(out, &self.busid, BUSID);
        for value in [1, self.number, self.descriptors.speed as u32] {
            out.extend_from_slice(&value.to_be_bytes());
        }
        let device = |at: usize| self.descriptors.device.get(at).copied().unwrap_or(0);
        // idVendor, idProduct, bcdDevice are little-endian in the descriptor, big-endian here.
        out.extend([9, 8, 11, 10, 13, 12].map(device));
        out.extend([4, 5, 6].map(device));
        let value = self.descriptors.configuration.get(5).copied().unwrap_or(1);
        out.extend([value, device(17), self.interfaces().len() as u8]);
        debug_assert_eq!(out.len() - start, 312);
    }
}
