//! A USB twin in memory: for drivers in tokio's time, so that a night under a paused clock takes seconds, or as a
//! blocking port in real time, for the thread that libusb lives on.
//!
//! The port survives reconnections and can be pulled out and put back. What waits in an endpoint survives them too, as
//! in a real device that nobody reset.

use super::usb::{Answer, Descriptors, SetupPacket, UsbTwin};
use async_trait::async_trait;
use goniod_drivers::clock::Clock;
use goniod_drivers::error::{DeviceError, ErrorKind, Result};
use goniod_drivers::transport::usb::{
    BulkEndpoint, Setup, Transfer, UsbConnector, UsbError, UsbInfo, UsbLink, UsbOpener, UsbPipe, UsbPort, UsbRequest,
};
use std::collections::BTreeSet;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::sync::watch;
use tokio::time::Instant;

/// Longest wait for a twin that has nothing to say, in tokio's time and in real time.
const IDLE: Duration = Duration::from_secs(3600);
const LOOK: Duration = Duration::from_millis(2);
/// Shortest wait, for a twin that is due and yet not ready.
const STEP: Duration = Duration::from_millis(1);

/// A place on the bus with a twin in it.
pub struct UsbBus<T> {
    inner: Arc<Inner<T>>,
}

/// Opens the device of a [`UsbBus`] in tokio's time.
pub struct MemoryConnector<T> {
    inner: Arc<Inner<T>>,
    clock: Clock,
}

/// Opens the device of a [`UsbBus`] in real time, with blocking calls.
pub struct MemoryOpener<T> {
    inner: Arc<Inner<T>>,
}

struct Inner<T> {
    name: String,
    twin: Arc<Mutex<T>>,
    state: watch::Sender<State>,
}

/// What a connection must know.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct State {
    plugged: bool,
    /// Counts connections and losses; a handle of an older one is dead.
    connection: u64,
    /// Counts touches from outside, after which a waiting transfer may end.
    touches: u64,
}

/// An opened device.
struct Handle<T> {
    inner: Arc<Inner<T>>,
    connection: u64,
    info: UsbInfo,
    halted: BTreeSet<u8>,
}

/// One transfer under way.
struct Flight {
    request: UsbRequest,
    deadline: Instant,
    got: Vec<u8>,
}

/// How far a transfer came.
enum Progress {
    Done(Transfer<Vec<u8>>),
    /// Look again then, or when somebody touches the twin.
    Wait(Instant),
}

struct MemoryPipe<T> {
    handle: Handle<T>,
    state: watch::Receiver<State>,
    clock: Clock,
}

struct MemoryPort<T> {
    handle: Handle<T>,
}

// === impl UsbBus ===

impl<T> Clone for UsbBus<T> {
    fn clone(&self) -> UsbBus<T> {
        UsbBus { inner: Arc::clone(&self.inner) }
    }
}

impl<T: UsbTwin> UsbBus<T> {
    /// A place called `name` (`usb:1313:8078:P0001234`, `sim:light-monitor`).
    pub fn new(name: impl Into<String>, twin: T) -> UsbBus<T> {
        let state = watch::Sender::new(State { plugged: true, connection: 0, touches: 0 });
        UsbBus { inner: Arc::new(Inner { name: name.into(), twin: Arc::new(Mutex::new(twin)), state }) }
    }

    /// A connector for a driver, in tokio's time.
    pub fn connector(&self, clock: Clock) -> MemoryConnector<T> {
        MemoryConnector { inner: Arc::clone(&self.inner), clock }
    }

    /// An opener for a USB thread, in real time.
    pub fn opener(&self) -> MemoryOpener<T> {
        MemoryOpener { inner: Arc::clone(&self.inner) }
    }

    /// The twin itself, for a server that carries it to a kernel.
    pub fn twin(&self) -> Arc<Mutex<T>> {
        Arc::clone(&self.inner.twin)
    }

    /// Looks at the twin, or changes it (faults).
    pub fn with<R>(&self, act: impl FnOnce(&mut T) -> R) -> R {
        let result = act(&mut self.inner.twin());
        self.inner.state.send_modify(|s| s.touches += 1);
        result
    }

    /// Pulls the cable: transfers under way end, connecting fails.
    pub fn unplug(&self) {
        self.inner.state.send_modify(|s| {
            s.plugged = false;
            s.connection += 1;
        });
        self.inner.twin().reset(Instant::now());
    }

    /// Puts the cable back.
    pub fn plug(&self) {
        self.inner.state.send_modify(|s| s.plugged = true);
    }

    /// Pulls the cable and puts it back after `time`.
    pub fn unplug_for(&self, time: Duration) {
        self.unplug();
        let bus = self.clone();
        tokio::spawn(async move {
            Clock::system().sleep(time).await;
            bus.plug();
        });
    }
}

// === impl Inner ===

impl<T: UsbTwin> Inner<T> {
    fn twin(&self) -> MutexGuard<'_, T> {
        self.twin.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn open(inner: &Arc<Inner<T>>) -> Result<Handle<T>> {
        if !inner.state.borrow().plugged {
            let what = format!("USB device {} is not there; plug it in", inner.name);
            return Err(DeviceError::new(ErrorKind::Lost, &inner.name, what));
        }
        inner.state.send_modify(|s| s.connection += 1);
        let connection = inner.state.borrow().connection;
        let info = describe(&inner.twin().descriptors());
        Ok(Handle { inner: Arc::clone(inner), connection, info, halted: BTreeSet::new() })
    }
}

// === impl MemoryConnector ===

#[async_trait]
impl<T: UsbTwin> UsbConnector for MemoryConnector<T> {
    fn port(&self) -> &str {
        &self.inner.name
    }

    async fn connect(&mut self) -> Result<UsbLink> {
        let handle = Inner::open(&self.inner)?;
        let info = handle.info.clone();
        let state = self.inner.state.subscribe();
        Ok(UsbLink::new(MemoryPipe { handle, state, clock: self.clock }, info))
    }
}

#[async_trait]
impl<T: UsbTwin> UsbPipe for MemoryPipe<T> {
    async fn transfer(&mut self, request: UsbRequest, limit: Duration) -> Transfer<Vec<u8>> {
        let mut flight = Flight { request, deadline: self.clock.now() + limit, got: Vec::new() };
        loop {
            self.state.borrow_and_update();
            let until = match self.handle.advance(&mut flight, self.clock.now()) {
                Progress::Done(result) => return result,
                Progress::Wait(until) => until,
            };
            tokio::select! {
                () = self.clock.sleep_until(until) => {}
                changed = self.state.changed() => if changed.is_err() {
                    return Err(UsbError::Gone);
                }
            }
        }
    }
}

// === impl MemoryOpener ===

impl<T: UsbTwin> UsbOpener for MemoryOpener<T> {
    fn port(&self) -> &str {
        &self.inner.name
    }

    fn open(&self) -> Result<Box<dyn UsbPort>> {
        Ok(Box::new(MemoryPort { handle: Inner::open(&self.inner)? }))
    }
}

impl<T: UsbTwin> UsbPort for MemoryPort<T> {
    fn info(&self) -> UsbInfo {
        self.handle.info.clone()
    }

    fn transfer(&mut self, request: &UsbRequest, limit: Duration) -> Transfer<Vec<u8>> {
        let mut flight = Flight { request: request.clone(), deadline: Instant::now() + limit, got: Vec::new() };
        loop {
            let now = Instant::now();
            match self.handle.advance(&mut flight, now) {
                Progress::Done(result) => return result,
                Progress::Wait(until) => std::thread::park_timeout(until.saturating_duration_since(now).min(LOOK)),
            }
        }
    }
}

// === impl Handle ===

impl<T: UsbTwin> Handle<T> {
    /// Moves a transfer on as far as it goes at `now`.
    fn advance(&mut self, flight: &mut Flight, now: Instant) -> Progress {
        let state = *self.inner.state.borrow();
        if !state.plugged || state.connection != self.connection {
            return Progress::Done(Err(UsbError::Gone));
        }
        let (ended, due, left) = {
            let inner = Arc::clone(&self.inner);
            let mut twin = inner.twin();
            let ended = self.attempt(&mut *twin, flight, now);
            (ended, twin.due(), twin.left_bus())
        };
        if left {
            self.inner.state.send_modify(|s| s.connection += 1);
            return Progress::Done(Err(UsbError::Gone));
        }
        if let Some(result) = ended {
            return Progress::Done(result);
        }
        if now >= flight.deadline {
            // What came up to now is a success, as libusb has it.
            let got = std::mem::take(&mut flight.got);
            return Progress::Done(if got.is_empty() { Err(UsbError::Timeout) } else { Ok(got) });
        }
        Progress::Wait(due.unwrap_or(now + IDLE).max(now + STEP).min(flight.deadline))
    }

    /// One attempt; `None` while the device is not ready.
    fn attempt(&mut self, twin: &mut T, flight: &mut Flight, now: Instant) -> Option<Transfer<Vec<u8>>> {
        let answer = match &flight.request {
            UsbRequest::ClearHalt(endpoint) => {
                self.halted.remove(endpoint);
                twin.clear_halt(*endpoint, now);
                return Some(Ok(Vec::new()));
            }
            UsbRequest::BulkOut(endpoint, _) | UsbRequest::BulkIn(endpoint, _) if self.halted.contains(endpoint) => {
                Answer::Stall
            }
            UsbRequest::BulkOut(endpoint, bytes) => twin.bulk_out(*endpoint, bytes, now),
            UsbRequest::BulkIn(endpoint, length) => {
                return self.read(twin, *endpoint, *length, &mut flight.got, now);
            }
            UsbRequest::ControlOut(setup, bytes) => twin.control(packet(*setup, bytes.len()), bytes, now),
            UsbRequest::ControlIn(setup, length) => {
                let answer = twin.control(packet(*setup, *length), &[], now);
                if let Answer::Data(mut bytes) = answer {
                    bytes.truncate(*length);
                    return Some(Ok(bytes));
                }
                answer
            }
        };
        match (answer, &flight.request) {
            (Answer::Data(_), _) => Some(Ok(Vec::new())),
            (Answer::Nak, _) => None,
            (Answer::Stall, UsbRequest::BulkOut(endpoint, _) | UsbRequest::BulkIn(endpoint, _)) => {
                self.halted.insert(*endpoint);
                Some(Err(UsbError::Stall))
            }
            (Answer::Stall, _) => Some(Err(UsbError::Stall)),
        }
    }

    /// Gathers packets until a short one comes or the buffer is full.
    fn read(
        &mut self,
        twin: &mut T,
        endpoint: u8,
        length: usize,
        got: &mut Vec<u8>,
        now: Instant,
    ) -> Option<Transfer<Vec<u8>>> {
        let packet = self.info.endpoints.iter().find(|e| e.address == endpoint).map_or(64, |e| e.packet.max(1));
        loop {
            match twin.bulk_in(endpoint, length - got.len(), now) {
                Answer::Nak => return None,
                Answer::Stall => {
                    self.halted.insert(endpoint);
                    return Some(Err(UsbError::Stall));
                }
                Answer::Data(bytes) => {
                    let short = bytes.is_empty() || !bytes.len().is_multiple_of(packet);
                    got.extend(bytes);
                    if got.len() > length {
                        return Some(Err(UsbError::Overflow));
                    }
                    if short || got.len() == length {
                        return Some(Ok(std::mem::take(got)));
                    }
                }
            }
        }
    }
}

fn packet(setup: Setup, length: usize) -> SetupPacket {
    SetupPacket {
        request_type: setup.request_type,
        request: setup.request,
        value: setup.value,
        index: setup.index,
        length: u16::try_from(length).unwrap_or(u16::MAX),
    }
}

/// What a host reads from the descriptors: ids, strings, the first interface and its bulk endpoints.
fn describe(descriptors: &Descriptors) -> UsbInfo {
    let device = |at: usize| descriptors.device.get(at).copied().unwrap_or(0);
    let string = |at: usize| usize::from(device(at)).checked_sub(1).and_then(|i| descriptors.strings.get(i));
    let mut info = UsbInfo {
        vendor: u16::from_le_bytes([device(8), device(9)]),
        product: u16::from_le_bytes([device(10), device(11)]),
        manufacturer: string(14).cloned().unwrap_or_default(),
        name: string(15).cloned().unwrap_or_default(),
        serial: string(16).cloned().unwrap_or_default(),
        ..UsbInfo::default()
    };
    let mut rest = descriptors.configuration.as_slice();
    while let Some(&length) = rest.first()
        && length > 1
        && let Some((one, more)) = rest.split_at_checked(usize::from(length))
    {
        match *one {
            [_, 4, interface, _, _, class, subclass, protocol, ..] => {
                info.interface = interface;
                info.class = (class, subclass, protocol);
            }
            [_, 5, address, 2, low, high, ..] => {
                info.endpoints.push(BulkEndpoint { address, packet: u16::from_le_bytes([low, high]).into() });
            }
            _ => {}
        }
        rest = more;
    }
    info
}
