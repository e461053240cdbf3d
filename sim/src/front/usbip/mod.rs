//! A USB/IP server on TCP: any [`UsbTwin`] becomes a device that a kernel's `vhci-hcd` plugs in.
//!
//! A transfer that the device is not ready for waits, as on a real bus: the host times it out and takes it back. A
//! halted endpoint stays halted until the host clears it. Pulling a device out drops its connection.
//!
//! - [`wire`]: bytes; [`standard`]: requests every device answers; [`transfers`]: what waits and how it ends; [`vhci`]: the host's end

pub mod standard;
#[cfg(test)]
mod tests;
pub mod transfers;
pub mod vhci;
pub mod wire;

pub use transfers::{SharedTwin, Tally};

use crate::front::usb::UsbTwin;
use std::collections::BTreeMap;
use std::io::{self, BufReader, Write};
use std::net::{Shutdown, SocketAddr, TcpListener, TcpStream, ToSocketAddrs};
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::sync::mpsc::{RecvTimeoutError, SyncSender, sync_channel};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::time::Instant;
use transfers::Transfers;
use wire::{Command, Listing, Request};

/// Connections served at once.
const MOST_CONNECTIONS: usize = 32;
/// Commands that wait between socket and device.
const QUEUE: usize = 64;
/// Limit for the first request, and for a host that takes no bytes.
const PATIENCE: Duration = Duration::from_secs(5);
/// Longest time between two looks at a twin that said "not ready": a fault injected from outside may have changed it.
const LOOK: Duration = Duration::from_millis(20);
/// How long an import waits for the host before it, which may just be closing its connection.
const HANDOVER: Duration = Duration::from_millis(500);
/// Longest rest without any transfer.
const IDLE: Duration = Duration::from_secs(1);

/// A running server. Dropping it pulls all devices out.
pub struct UsbIpServer {
    inner: Arc<Inner>,
    address: SocketAddr,
}

struct Inner {
    ports: Mutex<BTreeMap<String, Port>>,
    /// A host has given a device back.
    freed: Condvar,
    stop: AtomicBool,
    connections: AtomicUsize,
    /// Counts imports, so that the end of an old one does not end a new one.
    imports: AtomicU64,
}

/// A place where a device is plugged in.
struct Port {
    twin: SharedTwin,
    number: u32,
    /// The host's connection while it has the device.
    host: Option<TcpStream>,
    /// The import that `host` made.
    import: u64,
    tally: Tally,
}

// === impl UsbIpServer ===

impl UsbIpServer {
    /// Listens on `address` (`127.0.0.1:0` for any free port).
    ///
    /// # Errors
    /// The address cannot be bound, or the system gives no thread.
    pub fn start(address: impl ToSocketAddrs) -> io::Result<UsbIpServer> {
        let listener = TcpListener::bind(address)?;
        let address = listener.local_addr()?;
        let inner = Arc::new(Inner {
            ports: Mutex::default(),
            freed: Condvar::new(),
            stop: AtomicBool::new(false),
            connections: AtomicUsize::new(0),
            imports: AtomicU64::new(0),
        });
        let accepting = Arc::clone(&inner);
        std::thread::Builder::new().name("usbip-accept".to_owned()).spawn(move || accepting.accept(&listener))?;
        Ok(UsbIpServer { inner, address })
    }

    /// Where it listens.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Plugs a twin in at `busid` (`1-1`); whatever was there is pulled out.
    pub fn plug<T: UsbTwin>(&self, busid: &str, twin: Arc<Mutex<T>>) {
        self.unplug(busid);
        let mut ports = self.inner.ports();
        let number = ports.values().map(|p| p.number).max().unwrap_or(1) + 1;
        ports.insert(busid.to_owned(), Port { twin, number, host: None, import: 0, tally: Tally::default() });
    }

    /// Pulls the device at `busid` out: its host sees it go. True when there was one.
    pub fn unplug(&self, busid: &str) -> bool {
        let port = self.inner.ports().remove(busid);
        if let Some(host) = port.as_ref().and_then(|p| p.host.as_ref()) {
            let _ = host.shutdown(Shutdown::Both);
        }
        port.is_some()
    }

    /// A host has the device at `busid`.
    pub fn is_imported(&self, busid: &str) -> bool {
        self.inner.ports().get(busid).is_some_and(|p| p.host.is_some())
    }

    /// What happened to the transfers of the device at `busid` in its present or last import.
    pub fn tally(&self, busid: &str) -> Option<Tally> {
        self.inner.ports().get(busid).map(|p| p.tally)
    }
}

impl Drop for UsbIpServer {
    fn drop(&mut self) {
        self.inner.stop.store(true, Ordering::SeqCst);
        for port in std::mem::take(&mut *self.inner.ports()).into_values() {
            if let Some(host) = port.host {
                let _ = host.shutdown(Shutdown::Both);
            }
        }
        // Wakes the accepting thread.
        let _ = TcpStream::connect(self.address);
    }
}

// === impl Inner ===

impl Inner {
    fn ports(&self) -> MutexGuard<'_, BTreeMap<String, Port>> {
        self.ports.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn accept(self: Arc<Inner>, listener: &TcpListener) {
        while let Ok((stream, _)) = listener.accept() {
            if self.stop.load(Ordering::SeqCst) {
                return;
            }
            if self.connections.load(Ordering::SeqCst) >= MOST_CONNECTIONS {
                tracing::warn!("USB/IP: {MOST_CONNECTIONS} connections are served, one more is refused");
                continue;
            }
            let inner = Arc::clone(&self);
            inner.connections.fetch_add(1, Ordering::SeqCst);
            let spawned = std::thread::Builder::new().name("usbip-host".to_owned()).spawn(move || {
                if let Err(error) = inner.serve(stream) {
                    tracing::debug!(%error, "USB/IP connection ended");
                }
                inner.connections.fetch_sub(1, Ordering::SeqCst);
            });
            if spawned.is_err() {
                self.connections.fetch_sub(1, Ordering::SeqCst);
            }
        }
    }

    /// Answers requests until one imports a device, then carries its transfers.
    fn serve(&self, mut stream: TcpStream) -> io::Result<()> {
        stream.set_nodelay(true)?;
        stream.set_read_timeout(Some(PATIENCE))?;
        stream.set_write_timeout(Some(PATIENCE))?;
        loop {
            match wire::read_request(&mut stream)? {
                Request::List => stream.write_all(&wire::device_list(&self.list()))?,
                Request::Import(busid) => return self.import(&busid, stream),
            }
        }
    }

    fn list(&self) -> Vec<Listing> {
        self.ports().iter().map(|(busid, port)| port.listing(busid)).collect()
    }

    fn import(&self, busid: &str, mut stream: TcpStream) -> io::Result<()> {
        let host = stream.try_clone()?;
        let taken = {
            let has_host = |ports: &mut BTreeMap<String, Port>| ports.get(busid).is_some_and(|p| p.host.is_some());
            let waited = self.freed.wait_timeout_while(self.ports(), HANDOVER, has_host);
            let (mut ports, _) = waited.unwrap_or_else(PoisonError::into_inner);
            match ports.get_mut(busid) {
                None => Err(wire::STATUS_NO_DEVICE),
                Some(port) if port.host.is_some() => Err(wire::STATUS_BUSY),
                Some(port) => {
                    port.host = Some(host);
                    port.import = self.imports.fetch_add(1, Ordering::SeqCst) + 1;
                    Ok((port.listing(busid), Arc::clone(&port.twin), port.import))
                }
            }
        };
        let (listing, twin, import) = match taken {
            Ok(taken) => taken,
            Err(status) => return stream.write_all(&wire::import_reply(Err(status))),
        };
        let carried = stream.write_all(&wire::import_reply(Ok(&listing))).and_then(|()| {
            stream.set_read_timeout(None)?;
            self.carry(busid, import, &mut stream, Arc::clone(&twin))
        });
        let _ = stream.shutdown(Shutdown::Both);
        let mut ports = self.ports();
        let port = ports.get_mut(busid);
        // A device that was pulled out and plugged in again may have another host by now.
        if port.as_ref().is_none_or(|p| p.import == import || p.host.is_none()) {
            twin.lock().unwrap_or_else(PoisonError::into_inner).reset(Instant::now());
        }
        if let Some(port) = port.filter(|p| p.import == import) {
            port.host = None;
        }
        self.freed.notify_all();
        carried
    }

    /// Carries transfers until either side closes.
    fn carry(&self, busid: &str, import: u64, stream: &mut TcpStream, twin: SharedTwin) -> io::Result<()> {
        let (sender, commands) = sync_channel(QUEUE);
        let reading = stream.try_clone()?;
        let reader = std::thread::Builder::new().name(format!("usbip-{busid}"));
        let reader = reader.spawn(move || read_commands(reading, &sender))?;
        let mut transfers = Transfers::new(twin);
        let mut out = Vec::new();
        let result = loop {
            let rest = match (transfers.due(), transfers.waits()) {
                (Some(due), _) => due.saturating_duration_since(Instant::now()).min(LOOK),
                (None, true) => LOOK,
                (None, false) => IDLE,
            };
            match commands.recv_timeout(rest) {
                Ok(command) => {
                    let now = Instant::now();
                    transfers.take(command, now, &mut out);
                    commands.try_iter().take(QUEUE).for_each(|command| transfers.take(command, now, &mut out));
                }
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => break Ok(()),
            }
            transfers.pump(Instant::now(), &mut out);
            if !out.is_empty()
                && let Some(port) = self.ports().get_mut(busid).filter(|p| p.import == import)
            {
                port.tally = transfers.tally();
            }
            if let Err(error) = stream.write_all(&out) {
                break Err(error);
            }
            out.clear();
        };
        let _ = stream.shutdown(Shutdown::Both);
        drop(commands);
        let _ = reader.join();
        result
    }
}

/// Hands commands on until the stream ends or says what the protocol does not know.
fn read_commands(stream: TcpStream, to: &SyncSender<Command>) {
    let mut stream = BufReader::with_capacity(64 << 10, stream);
    loop {
        match wire::read_command(&mut stream) {
            Ok(command) => {
                if to.send(command).is_err() {
                    return;
                }
            }
            Err(error) => {
                if error.kind() == io::ErrorKind::InvalidData {
                    tracing::warn!(%error, "USB/IP: the connection is dropped");
                }
                return;
            }
        }
    }
}

// === impl Port ===

impl Port {
    fn listing(&self, busid: &str) -> Listing {
        let descriptors = self.twin.lock().unwrap_or_else(PoisonError::into_inner).descriptors();
        Listing { busid: busid.to_owned(), number: self.number, descriptors }
    }
}
