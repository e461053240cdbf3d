//! Plugs devices of a USB/IP server into this machine's `vhci-hcd`, as `usbip attach` does, and pulls them out.

use std::fs;
use std::io::{self, Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::os::fd::AsRawFd;
use std::time::Duration;

/// Where the kernel's virtual host controller lies.
const DIR: &str = "/sys/devices/platform/vhci_hcd.0";
/// `VDEV_ST_NULL`: nothing is plugged in.
const FREE: &str = "004";
/// Limit for the server's answer.
const PATIENCE: Duration = Duration::from_secs(5);

/// A device that is plugged in.
#[derive(Debug)]
pub struct Attached {
    port: String,
}

/// True where this machine has a virtual host controller that this process may use.
pub fn is_usable() -> bool {
    fs::OpenOptions::new().write(true).open(format!("{DIR}/attach")).is_ok()
}

/// Imports `busid` from the server and plugs it into a free high-speed port.
///
/// # Errors
/// No server, no such device, no free port, no leave.
pub fn attach(server: SocketAddr, busid: &str) -> io::Result<Attached> {
    let mut stream = TcpStream::connect(server)?;
    stream.set_nodelay(true)?;
    stream.set_read_timeout(Some(PATIENCE))?;
    let mut request = vec![0x01, 0x11, 0x80, 0x03, 0, 0, 0, 0];
    request.extend(busid.bytes());
    request.resize(40, 0);
    stream.write_all(&request)?;
    let mut head = [0; 8];
    stream.read_exact(&mut head)?;
    let [.., status] = head;
    if status != 0 {
        return Err(io::Error::other(format!("the server refuses {busid}: status {status}")));
    }
    let mut record = [0; 312];
    stream.read_exact(&mut record)?;
    let word = |at: usize| -> u32 {
        let bytes = record.get(at..at + 4).and_then(|b| b.try_into().ok());
        bytes.map_or(0, u32::from_be_bytes)
    };
    let (devid, speed) = (word(288) << 16 | word(292), word(296));
    let status = fs::read_to_string(format!("{DIR}/status"))?;
    let free = status.lines().map(|l| l.split_whitespace().collect::<Vec<_>>());
    let port = free
        .filter(|f| f.first() == Some(&"hs") && f.get(2) == Some(&FREE))
        .find_map(|f| f.get(1).and_then(|p| p.parse::<u32>().ok()))
        .ok_or_else(|| io::Error::other("no free port of the virtual host controller"))?;
    // The kernel takes the connection over: it waits as long as it likes.
    stream.set_read_timeout(None)?;
    fs::write(format!("{DIR}/attach"), format!("{port} {} {devid} {speed}", stream.as_raw_fd()))?;
    Ok(Attached { port: port.to_string() })
}

// === impl Attached ===

impl Attached {
    /// Pulls the device out on the host's side.
    ///
    /// # Errors
    /// It is out already, no leave.
    pub fn detach(&self) -> io::Result<()> {
        fs::write(format!("{DIR}/detach"), &self.port)
    }
}
