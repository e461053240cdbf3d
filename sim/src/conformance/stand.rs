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

/// A place that an adapter with a twin can be plugged into, under a name of its own.
pub trait Socket: Send {
    /// The adapter is put in.
    fn put(&self);
    /// The adapter is pulled out.
    fn pull(&self);
    /// What changed in the twin goes out now.
    fn stir(&self);
    /// Connectors for a driver that finds the adapter in either place.
    fn connectors(places: &[Self; 2], clock: Clock) -> Plug
    where
        Self: Sized;
}

/// A twin whose adapter is in one of two places.
pub struct TwinStand<T, P> {
    watched: Watched<T>,
    places: [P; 2],
    handles: Handles<T>,
}

/// A twin behind a serial adapter that has one of two names.
pub type SerialStand<T> = TwinStand<T, PipePort<Watched<T>>>;

/// A USB twin in one of two places of the bus.
pub type UsbStand<T> = TwinStand<T, UsbBus<Watched<T>>>;

/// Finds a device again by what it is, whatever name its adapter has got: as a link by id does.
struct Finder<C>([C; 2]);

// === impl Socket ===

impl<T: Firmware> Socket for PipePort<Watched<T>> {
    fn put(&self) {
        self.plug();
    }

    fn pull(&self) {
        self.unplug();
    }

    fn stir(&self) {
        self.with(|_| ());
    }

    fn connectors([first, second]: &[Self; 2], clock: Clock) -> Plug {
        Plug::Serial(Box::new(Finder([first.connector(clock), second.connector(clock)])))
    }
}

impl<T: UsbTwin> Socket for UsbBus<Watched<T>> {
    fn put(&self) {
        self.plug();
    }

    fn pull(&self) {
        self.unplug();
    }

    fn stir(&self) {
        self.with(|_| ());
    }

    fn connectors([first, second]: &[Self; 2], clock: Clock) -> Plug {
        Plug::Usb(Box::new(Finder([first.connector(clock), second.connector(clock)])))
    }
}

// === impl TwinStand ===

impl<T: Firmware> SerialStand<T> {
    /// A stand with this twin, its adapter plugged in under its first name.
    pub fn new(twin: T, handles: Handles<T>) -> SerialStand<T> {
        TwinStand::of(twin, handles, |watched| {
            ["sim:ttyUSB0", "sim:ttyUSB1"].map(|name| PipePort::new(name, watched.clone()))
        })
    }
}

impl<T: UsbTwin> UsbStand<T> {
    /// A stand with this twin, plugged into its first place.
    pub fn new(twin: T, handles: Handles<T>) -> UsbStand<T> {
        TwinStand::of(twin, handles, |watched| ["usb:1-1", "usb:1-2"].map(|name| UsbBus::new(name, watched.clone())))
    }
}

impl<T, P: Socket> TwinStand<T, P> {
    fn of(twin: T, handles: Handles<T>, places: impl FnOnce(&Watched<T>) -> [P; 2]) -> TwinStand<T, P> {
        let watched = Watched::new(twin, handles.restart);
        let places = places(&watched);
        places[1].pull();
        TwinStand { watched, places, handles }
    }

    fn change(&self, act: impl FnOnce(&mut T)) {
        act(&mut self.watched.twin());
        self.places.iter().for_each(Socket::stir);
    }
}

impl<T: Send, P: Socket> Stand for TwinStand<T, P> {
    fn plug(&self, clock: Clock) -> Plug {
        P::connectors(&self.places, clock)
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
        self.places.iter().for_each(Socket::pull);
    }

    fn plug_elsewhere(&self) {
        self.places[1].put();
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
