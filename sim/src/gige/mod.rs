//! A GigE Vision camera in software, on real UDP sockets of a loopback address.
//!
//! Bootstrap registers, GenICam XML with SFNC names, privilege and heartbeat, stream with resend: any GigE Vision client
//! drives it. Its picture comes from a [`Scene`]; what it really did for every block is in [`GigeTwin::truth`], so a
//! test can hold a frame's label against it. Every 127.0.0.x is a camera of its own, without configuration.
//!
//! - [`scene`](crate::scene): what is photographed; [`bench_scene`]: the simulated bench as a scene
//! - [`faults`]: what can go wrong, and the record of truth
//! - [`registers`], [`address`], [`xml`]: what it tells and obeys
//! - [`gvcp`], [`gvsp`], [`pixel`]: the bytes
//! - [`control`], [`sensor`], [`shared`]: its two threads and what they share

pub mod address;
pub mod bench_scene;
pub mod control;
mod discovery;
pub mod faults;
pub mod gvcp;
pub mod gvsp;
pub mod pixel;
pub mod registers;
pub mod sensor;
pub mod shared;
pub mod xml;

pub use crate::scene::{ExposureRequest, Painted, Reading, Scene, Tag};
pub use bench_scene::BenchScene;
pub use faults::{Faults, FrameFault, Traffic, Truth};
pub use pixel::PixelCode;
pub use registers::Sensor;
pub use shared::TwinConfig;

use control::Control;
use sensor::SensorThread;
use shared::{Order, Shared};
use std::io;
use std::net::{SocketAddrV4, UdpSocket};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::sync::mpsc::{Sender, channel};
use std::thread::JoinHandle;

/// The GVCP port.
pub const PORT: u16 = 3956;

/// A camera that is switched on. Dropping it cuts its power.
pub struct GigeTwin {
    shared: Arc<Shared>,
    threads: Vec<JoinHandle<()>>,
    orders: Option<Sender<Order>>,
}

// === impl GigeTwin ===

impl GigeTwin {
    /// Switches a camera on.
    ///
    /// # Errors
    /// The sockets cannot be bound: the address is not a local one, or another camera has it.
    pub fn start(config: TwinConfig, scene: Arc<dyn Scene>) -> io::Result<GigeTwin> {
        let mut twin = GigeTwin { shared: Arc::new(Shared::new(config, scene)), threads: Vec::new(), orders: None };
        twin.power_up()?;
        Ok(twin)
    }

    /// The address to open it by.
    pub fn address(&self) -> String {
        self.shared.config.address.to_string()
    }

    /// Changes the faults in force.
    pub fn faults(&self, change: impl FnOnce(&mut Faults)) {
        change(&mut self.shared.faults());
    }

    /// What it really did, block by block since it was made.
    pub fn truth(&self) -> Vec<Truth> {
        self.shared.truth().clone()
    }

    /// Forgets the record of what it did.
    pub fn clear_truth(&self) {
        self.shared.truth().clear();
    }

    /// What went over the wire since it was made.
    pub fn traffic(&self) -> Traffic {
        *self.shared.traffic()
    }

    /// Sets a register past all access rules, as the hardware itself would (temperature, cooler).
    pub fn set_register(&self, address: u32, value: u32) {
        self.shared.registers().put(address, value);
    }

    /// Sets a double register past all access rules.
    pub fn set_register_f64(&self, address: u32, value: f64) {
        self.shared.registers().put_f64(address, value);
    }

    /// The integration time its register holds now, in microseconds.
    pub fn exposure_us(&self) -> f64 {
        self.shared.registers().get_f64(address::EXPOSURE)
    }

    /// The gain its register holds now, in dB.
    pub fn gain_db(&self) -> f64 {
        self.shared.registers().get_f64(address::GAIN)
    }

    /// Takes control away from whoever has it.
    pub fn drop_control(&self) {
        if let Some(orders) = &self.orders {
            control::drop_control(&self.shared, orders);
        }
    }

    /// Hangs (true) or thaws (false), as a stopped process would: nothing is answered, nothing sent.
    pub fn freeze(&self, on: bool) {
        self.shared.frozen.store(on, Ordering::SeqCst);
    }

    /// Cuts the power: sockets closed, settings forgotten.
    pub fn kill(&mut self) {
        self.shared.stop.store(true, Ordering::SeqCst);
        if let Some(orders) = self.orders.take() {
            let _ = orders.send(Order::Quit);
        }
        for thread in self.threads.drain(..) {
            thread.thread().unpark();
            let _ = thread.join();
        }
        self.shared.forget();
    }

    /// Switches on again after [`GigeTwin::kill`], with power-up features.
    ///
    /// # Errors
    /// The sockets cannot be bound again.
    pub fn power_up(&mut self) -> io::Result<()> {
        let config = &self.shared.config;
        let socket = UdpSocket::bind(SocketAddrV4::new(config.address, PORT))?;
        let stream = UdpSocket::bind(SocketAddrV4::new(config.address, 0))?;
        let source = stream.local_addr()?.port();
        self.shared.stop.store(false, Ordering::SeqCst);
        self.shared.registers().put(address::STREAM_SOURCE, u32::from(source));
        let calls = config.discoverable.then(|| Ok::<_, io::Error>((discovery::listen()?, socket.try_clone()?)));
        let calls = calls.transpose()?;
        let (orders, inbox) = channel();
        let control = Control::new(Arc::clone(&self.shared), socket, stream.try_clone()?, orders.clone());
        let sensor = SensorThread::new(Arc::clone(&self.shared), stream, inbox);
        let name = |part: &str| format!("gige-{part}-{}", config.serial);
        self.threads = vec![
            std::thread::Builder::new().name(name("control")).spawn(move || control.run())?,
            std::thread::Builder::new().name(name("sensor")).spawn(move || sensor.run())?,
        ];
        if let Some((heard, answers)) = calls {
            let shared = Arc::clone(&self.shared);
            let serve = move || discovery::serve(&shared, &heard, &answers);
            self.threads.push(std::thread::Builder::new().name(name("discovery")).spawn(serve)?);
        }
        self.orders = Some(orders);
        Ok(())
    }
}

impl Drop for GigeTwin {
    fn drop(&mut self) {
        self.kill();
    }
}
