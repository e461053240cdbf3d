//! A whole bench in real time for another process: serial devices as pseudo-terminals under stable names in a folder,
//! cameras as GigE Vision devices on loopback addresses, USB devices by USB/IP, faults and truth by a socket.
//!
//! - [`cameras`], [`usb`]: what is not a serial line
//! - [`board`], [`channel`]: faults to come and true state, by a line of text
//! - [`choice`], [`words`]: which faults each model has

pub mod board;
pub mod cameras;
pub mod channel;
pub mod choice;
#[cfg(test)]
mod tests;
pub mod usb;
pub mod words;

pub use usb::UsbSite;

use crate::bench::Bench;
use crate::front::PtyPort;
use crate::truth::error::SimError;
use crate::twins::Twins;
use board::Board;
use goniod_drivers::clock::Clock;
use goniod_drivers::devices::CameraConfig;
use std::collections::BTreeMap;
use std::io;
use std::net::Ipv4Addr;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};
use thiserror::Error;
use tokio::task::JoinHandle;
use usb::UsbDevices;

/// Name of the side channel in the folder.
pub const SOCKET: &str = "faults.sock";

/// A serial device, whose port has a name in the folder.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Line {
    /// Sample holder.
    Holder,
    /// Filter wheel.
    FilterWheel,
    /// Shutter.
    Shutter,
    /// Light monitor.
    LightMonitor,
    /// Monochromator.
    Monochromator,
}

/// What stands on the bench and where it is served.
#[derive(Debug, Clone, PartialEq)]
pub struct Site {
    /// Folder of ports and socket; made where it is missing.
    pub folder: PathBuf,
    /// Serial devices.
    pub lines: Vec<Line>,
    /// Cameras by name, each of them one of the bench's.
    pub cameras: BTreeMap<String, CameraConfig>,
    /// The light monitor, where it is a Thorlabs PM100.
    pub meter: Option<UsbSite>,
    /// The spectrometer.
    pub spectrometer: Option<UsbSite>,
    /// Seed of what the cameras lose.
    pub seed: u64,
}

/// A bench that is served until it is ended or dropped.
pub struct Served {
    folder: PathBuf,
    ports: Vec<PtyPort>,
    addresses: BTreeMap<String, String>,
    board: Arc<Board>,
    channel: JoinHandle<()>,
}

/// Why a bench cannot be served.
#[derive(Debug, Error)]
pub enum ServeError {
    /// A file, link or socket of the folder.
    #[error("{path}: {source}; choose another folder, or make this one writable")]
    Folder {
        /// Which.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// Another simulation.
    #[error("{folder} belongs to a simulation that runs; choose another folder, or end that one")]
    InUse {
        /// The folder.
        folder: PathBuf,
    },
    /// A camera that cannot be what the instrument says.
    #[error("camera `{name}`: {message}")]
    Camera {
        /// Name in the instrument file.
        name: String,
        /// What is wrong and what to do.
        message: String,
    },
    /// An address of a camera.
    #[error(
        "camera `{name}`: {address} cannot be used: {source}; does this machine have the loopback network 127.0.0.0/8?"
    )]
    Address {
        /// Camera.
        name: String,
        /// The address.
        address: Ipv4Addr,
        /// What the system said.
        source: io::Error,
    },
    /// The USB/IP server.
    #[error("no port for USB/IP on 127.0.0.1: {0}")]
    Usb(io::Error),
    /// The bench's files.
    #[error(transparent)]
    Bench(#[from] SimError),
}

// === impl Line ===

impl Line {
    /// Name of its port in the folder.
    pub fn name(self) -> &'static str {
        match self {
            Line::Holder => "holder",
            Line::FilterWheel => "filter-wheel",
            Line::Shutter => "shutter",
            Line::LightMonitor => "light-monitor",
            Line::Monochromator => "monochromator",
        }
    }

    fn open(self, path: PathBuf, twins: &Twins, clock: Clock) -> io::Result<PtyPort> {
        match self {
            Line::Holder => PtyPort::open(path, &twins.holder, clock),
            Line::FilterWheel => PtyPort::open(path, &twins.wheel, clock),
            Line::Shutter => PtyPort::open(path, &twins.shutter, clock),
            Line::LightMonitor => PtyPort::open(path, &twins.light_monitor, clock),
            Line::Monochromator => PtyPort::open(path, &twins.monochromator, clock),
        }
    }
}

// === impl Served ===

impl Served {
    /// Switches everything on. Needs a tokio runtime with I/O, in real time.
    ///
    /// # Errors
    /// [`ServeError`]; what was begun is put away again.
    pub fn start(site: &Site, twins: Twins, bench: &Bench, clock: Clock) -> Result<Served, ServeError> {
        let folder = &site.folder;
        std::fs::create_dir_all(folder).map_err(|e| failed(folder, e))?;
        let socket = folder.join(SOCKET);
        let listener = channel::listen(&socket).map_err(|e| match e.kind() {
            io::ErrorKind::AddrInUse => ServeError::InUse { folder: folder.clone() },
            _ => failed(&socket, e),
        })?;
        let opened = board(site, twins, bench, clock).and_then(|(board, addresses)| {
            let ports = site.lines.iter().map(|line| {
                let path = folder.join(line.name());
                line.open(path.clone(), &board.twins, clock).map_err(|e| failed(&path, e))
            });
            Ok((ports.collect::<Result<Vec<PtyPort>, ServeError>>()?, board, addresses))
        });
        let (ports, board, addresses) = opened.inspect_err(|_| drop(std::fs::remove_file(&socket)))?;
        let board = Arc::new(board);
        let channel = tokio::spawn(channel::serve(listener, Arc::clone(&board)));
        Ok(Served { folder: folder.clone(), ports, addresses, board, channel })
    }

    /// Address of each camera.
    pub fn addresses(&self) -> &BTreeMap<String, String> {
        &self.addresses
    }

    /// Names of the serial ports.
    pub fn ports(&self) -> Vec<&Path> {
        self.ports.iter().map(PtyPort::path).collect()
    }

    /// What an operator must do for the USB devices.
    pub fn usb_hints(&self) -> Vec<String> {
        self.board.usb.hints()
    }

    /// Where faults and questions go.
    pub fn board(&self) -> &Arc<Board> {
        &self.board
    }
}

impl Drop for Served {
    fn drop(&mut self) {
        self.channel.abort();
        // Now, not when the last client of the side channel has left: their addresses are free again.
        self.board.cameras.values().for_each(|camera| board::lock(camera).kill());
        // Names that are gone already need no removal.
        for port in self.ports.drain(..) {
            let _ = std::fs::remove_file(port.path());
        }
        let _ = std::fs::remove_file(self.folder.join(SOCKET));
    }
}

fn failed(path: &Path, source: io::Error) -> ServeError {
    ServeError::Folder { path: path.to_owned(), source }
}

/// Cameras and USB devices switched on, with the addresses of the cameras.
fn board(
    site: &Site,
    twins: Twins,
    bench: &Bench,
    clock: Clock,
) -> Result<(Board, BTreeMap<String, String>), ServeError> {
    let mut next = first_address(&site.folder);
    let (mut cameras, mut addresses) = (BTreeMap::new(), BTreeMap::new());
    for (name, camera) in &site.cameras {
        let twin = cameras::start(name, camera, bench, site.seed, next)?;
        next = twin.address().parse().map_or(next, |address: Ipv4Addr| Ipv4Addr::from(u32::from(address) + 1));
        addresses.insert(name.clone(), twin.address());
        cameras.insert(name.clone(), Arc::new(Mutex::new(twin)));
    }
    let usb = UsbDevices::start(site.meter.as_ref(), site.spectrometer.as_ref(), bench.lamp(), clock);
    let board = Board {
        lamp: bench.lamp().clone(),
        monochromator: site.lines.contains(&Line::Monochromator),
        light_monitor: site.lines.contains(&Line::LightMonitor),
        cameras,
        usb: usb.map_err(ServeError::Usb)?,
        clock,
        asked: Mutex::default(),
        twins,
    };
    Ok((board, addresses))
}

/// Where the search for free loopback addresses begins: the same for the same folder, others for others, so that a
/// simulation that is started again has the cameras where they were.
fn first_address(folder: &Path) -> Ipv4Addr {
    let real = std::fs::canonicalize(folder).unwrap_or_else(|_| folder.to_owned());
    let bytes = real.as_os_str().as_encoded_bytes();
    let hash = bytes.iter().fold(0x811c_9dc5_u32, |hash, byte| (hash ^ u32::from(*byte)).wrapping_mul(0x0100_0193));
    let [a, b, c, _] = hash.to_be_bytes();
    Ipv4Addr::new(127, 16 + a % 224, b, 1 + c % 4)
}
