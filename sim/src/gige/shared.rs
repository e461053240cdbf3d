//! What the twin's two threads and its owner share: registers, faults, the record of what was done, counters.

use super::faults::{Faults, Traffic, Truth};
use super::gvsp::Block;
use super::registers::{Registers, Sensor};
use crate::scene::Scene;
use std::collections::VecDeque;
use std::net::{Ipv4Addr, SocketAddrV4};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::time::Instant;

/// How a twin is made.
#[derive(Clone)]
pub struct TwinConfig {
    /// Loopback address; port 3956 is taken on it.
    pub address: Ipv4Addr,
    /// Serial number it tells.
    pub serial: String,
    /// The sensor.
    pub sensor: Sensor,
    /// False: exposures and read-out take no time (frames are still paced by the frame rate).
    pub real_exposure: bool,
    /// Read-out time of one frame.
    pub readout: Duration,
    /// Pause after so many stream packets, where the host asks for no delay: spares small socket buffers.
    pub pace: Option<(u32, Duration)>,
    /// Blocks kept for resend.
    pub kept_blocks: usize,
    /// Seed of packet loss and frame faults.
    pub seed: u64,
    /// It answers broadcast discovery too; without, it is opened by its address.
    pub discoverable: bool,
}

/// What the control thread tells the sensor thread.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Order {
    /// Start acquisition.
    Start,
    /// Stop acquisition.
    Stop,
    /// Trigger one frame.
    Trigger,
    /// Leave the thread.
    Quit,
}

/// Shared by all parts of one twin.
pub struct Shared {
    /// How it was made.
    pub config: TwinConfig,
    /// What it photographs.
    pub scene: Arc<dyn Scene>,
    /// When its time stamp began to count (moved by a restart).
    pub born: Mutex<Instant>,
    registers: Mutex<Registers>,
    faults: Mutex<Faults>,
    truth: Mutex<Vec<Truth>>,
    traffic: Mutex<Traffic>,
    sent: Mutex<VecDeque<Block>>,
    controller: Mutex<Option<SocketAddrV4>>,
    /// A host has taken control, and acquisition has not begun since.
    pub taken: AtomicBool,
    /// The twin hangs.
    pub frozen: AtomicBool,
    /// The threads are to end.
    pub stop: AtomicBool,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Waits, though never past `limit`; may return early.
pub fn pause(limit: Duration) {
    std::thread::park_timeout(limit);
}

// === impl TwinConfig ===

impl TwinConfig {
    /// A 320 x 256 camera at `address` whose exposures take no real time.
    pub fn quick(address: Ipv4Addr, serial: &str) -> TwinConfig {
        TwinConfig {
            address,
            serial: serial.to_owned(),
            sensor: Sensor::default(),
            real_exposure: false,
            readout: Duration::from_millis(3),
            pace: Some((16, Duration::from_micros(60))),
            kept_blocks: 16,
            seed: 1,
            discoverable: false,
        }
    }
}

// === impl Shared ===

impl Shared {
    /// A twin's common state after power-up.
    pub fn new(config: TwinConfig, scene: Arc<dyn Scene>) -> Shared {
        let registers = Registers::power_up(&config.sensor, &config.serial, config.address);
        Shared {
            config,
            scene,
            born: Mutex::new(Instant::now()),
            registers: Mutex::new(registers),
            faults: Mutex::default(),
            truth: Mutex::default(),
            traffic: Mutex::default(),
            sent: Mutex::default(),
            controller: Mutex::default(),
            taken: AtomicBool::new(false),
            frozen: AtomicBool::new(false),
            stop: AtomicBool::new(false),
        }
    }

    /// Everything a power cut forgets.
    pub fn forget(&self) {
        *lock(&self.registers) = Registers::power_up(&self.config.sensor, &self.config.serial, self.config.address);
        *lock(&self.born) = Instant::now();
        *lock(&self.controller) = None;
        lock(&self.sent).clear();
    }

    /// The registers.
    pub fn registers(&self) -> MutexGuard<'_, Registers> {
        lock(&self.registers)
    }

    /// The faults in force.
    pub fn faults(&self) -> MutexGuard<'_, Faults> {
        lock(&self.faults)
    }

    /// The record of what was done.
    pub fn truth(&self) -> MutexGuard<'_, Vec<Truth>> {
        lock(&self.truth)
    }

    /// Counters of the wire.
    pub fn traffic(&self) -> MutexGuard<'_, Traffic> {
        lock(&self.traffic)
    }

    /// Who controls the camera.
    pub fn controller(&self) -> MutexGuard<'_, Option<SocketAddrV4>> {
        lock(&self.controller)
    }

    /// Device time of an instant in ticks of 1 ns.
    pub fn ticks(&self, at: Instant) -> u64 {
        at.saturating_duration_since(*lock(&self.born)).as_nanos() as u64
    }

    /// Keeps a block for resend.
    pub fn keep(&self, block: Block) {
        let mut sent = lock(&self.sent);
        if sent.len() >= self.config.kept_blocks.max(1) {
            sent.pop_front();
        }
        sent.push_back(block);
    }

    /// A block that was sent lately.
    pub fn kept(&self, id: u16) -> Option<Block> {
        lock(&self.sent).iter().rev().find(|b| b.id == id).cloned()
    }

    /// Holds the calling thread while the twin hangs; false when it is to end.
    pub fn alive(&self) -> bool {
        while self.frozen.load(Ordering::SeqCst) && !self.stop.load(Ordering::SeqCst) {
            pause(Duration::from_millis(2));
        }
        !self.stop.load(Ordering::SeqCst)
    }
}
