//! A twin on a stand: what the suite may do to it, whatever it is, and the truth it judges a driver by.

use super::line::{Line, Watched};
use crate::firmware::{Firmware, WireFault};
use crate::front::usb::UsbTwin;
use crate::front::{PipePort, UsbBus};
use async_trait::async_trait;
use goniod_drivers::clock::Clock;
use goniod_drivers::conformance::Value;
use goniod_drivers::error::Result;
use goniod_drivers::transport::{Connector, Link, UsbConnector, UsbLink};
use tokio::time::Instant;

/// What may be done to a device from outside, and what is true of it.
pub trait Stand: Send {
    /// A connector for a driver.
    fn plug(&self, clock: Clock) -> Plug;
    /// The hand on its line.
    fn line(&self) -> &Line;
    /// This happens to the next answer that has nothing waiting; false for a device that never answers.
    fn disturb(&self, fault: WireFault) -> bool;
    /// True while a disturbance waits for its answer.
    fn disturbed(&self) -> bool;
    /// The power fails and comes back now.
    fn restart(&self);
    /// The adapter is pulled out.
    fn unplug(&self);
    /// The adapter is put back and gets another name than before.
    fn plug_elsewhere(&self);
    /// Something a driver said after `since` is true now, or was at an instant between; else what is.
    fn judge(&self, said: &Value, since: Instant) -> std::result::Result<(), String>;
}

/// What a driver is connected with.
pub enum Plug {
    /// A serial line.
    Serial(Box<dyn Connector>),
    /// A place on the USB.
    Usb(Box<dyn UsbConnector>),
}

/// How the suite handles one sort of twin.
pub struct Handles<T> {
    /// Lets the power fail and come back.
    pub restart: fn(&mut T, Instant),
    /// Disturbs the next answer; `None` for a device that never answers.
    pub disturb: Option<fn(&mut T, WireFault, Instant)>,
    /// True while a disturbance waits.
    pub disturbed: fn(&T) -> bool,
    /// True when `said` held at an instant from the first to the second; else what is.
    pub judge: Judge<T>,
}

/// Judges what was said between two instants.
pub type Judge<T> = fn(&T, &Value, [Instant; 2]) -> std::result::Result<(), String>;

/// A twin behind a serial adapter that has one of two names.
pub struct SerialStand<T> {
    watched: Watched<T>,
    ports: [PipePort<Watched<T>>; 2],
    handles: Handles<T>,
}

/// A USB twin in one of two places of the bus.
pub struct UsbStand<T> {
    watched: Watched<T>,
    places: [UsbBus<Watched<T>>; 2],
    handles: Handles<T>,
}

/// Finds a device again by what it is, whatever name its adapter has got: as a link by id does.
struct Finder<C>([C; 2]);

// === impl SerialStand ===

impl<T: Firmware> SerialStand<T> {
    /// A stand with this twin, its adapter plugged in under its first name.
    pub fn new(twin: T, handles: Handles<T>) -> SerialStand<T> {
        let watched = Watched::new(twin, handles.restart);
        let ports = ["sim:ttyUSB0", "sim:ttyUSB1"].map(|name| PipePort::new(name, watched.clone()));
        ports[1].unplug();
        SerialStand { watched, ports, handles }
    }

    fn change(&self, act: impl FnOnce(&mut T)) {
        act(&mut self.watched.twin());
        self.ports.iter().for_each(|port| port.with(|_| ()));
    }
}

impl<T: Firmware> Stand for SerialStand<T> {
    fn plug(&self, clock: Clock) -> Plug {
        let [first, second] = &self.ports;
        Plug::Serial(Box::new(Finder([first.connector(clock), second.connector(clock)])))
    }

    fn line(&self) -> &Line {
        self.watched.line()
    }

    fn disturb(&self, fault: WireFault) -> bool {
        let Some(disturb) = self.handles.disturb else { return false };
        self.change(|twin| disturb(twin, fault, Instant::now()));
        true
    }

    fn disturbed(&self) -> bool {
        (self.handles.disturbed)(&self.watched.twin())
    }

    fn restart(&self) {
        self.change(|twin| (self.handles.restart)(twin, Instant::now()));
    }

    fn unplug(&self) {
        self.ports.iter().for_each(PipePort::unplug);
    }

    fn plug_elsewhere(&self) {
        self.ports[1].plug();
    }

    fn judge(&self, said: &Value, since: Instant) -> std::result::Result<(), String> {
        (self.handles.judge)(&self.watched.twin(), said, [since, Instant::now()])
    }
}

// === impl UsbStand ===

impl<T: UsbTwin> UsbStand<T> {
    /// A stand with this twin, plugged into its first place.
    pub fn new(twin: T, handles: Handles<T>) -> UsbStand<T> {
        let watched = Watched::new(twin, handles.restart);
        let places = ["usb:1-1", "usb:1-2"].map(|name| UsbBus::new(name, watched.clone()));
        places[1].unplug();
        UsbStand { watched, places, handles }
    }

    fn change(&self, act: impl FnOnce(&mut T)) {
        act(&mut self.watched.twin());
        self.places.iter().for_each(|place| place.with(|_| ()));
    }
}

impl<T: UsbTwin> Stand for UsbStand<T> {
    fn plug(&self, clock: Clock) -> Plug {
        let [first, second] = &self.places;
        Plug::Usb(Box::new(Finder([first.connector(clock), second.connector(clock)])))
    }

    fn line(&self) -> &Line {
        self.watched.line()
    }

    fn disturb(&self, fault: WireFault) -> bool {
        let Some(disturb) = self.handles.disturb else { return false };
        self.change(|twin| disturb(twin, fault, Instant::now()));
        true
    }

    fn disturbed(&self) -> bool {
        (self.handles.disturbed)(&self.watched.twin())
    }

    fn restart(&self) {
        self.change(|twin| (self.handles.restart)(twin, Instant::now()));
    }

    fn unplug(&self) {
        self.places.iter().for_each(UsbBus::unplug);
    }

    fn plug_elsewhere(&self) {
        self.places[1].plug();
    }

    fn judge(&self, said: &Value, since: Instant) -> std::result::Result<(), String> {
        (self.handles.judge)(&self.watched.twin(), said, [since, Instant::now()])
    }
}

// === impl Finder ===

#[async_trait]
impl<C: Connector> Connector for Finder<C> {
    fn port(&self) -> &str {
        "sim:by-id"
    }

    async fn connect(&mut self) -> Result<Link> {
        let [first, second] = &mut self.0;
        match first.connect().await {
            Ok(link) => Ok(link),
            Err(_) => second.connect().await,
        }
    }
}

#[async_trait]
impl<C: UsbConnector> UsbConnector for Finder<C> {
    fn port(&self) -> &str {
        "usb:by-id"
    }

    async fn connect(&mut self) -> Result<UsbLink> {
        let [first, second] = &mut self.0;
        match first.connect().await {
            Ok(link) => Ok(link),
            Err(_) => second.connect().await,
        }
    }
}
