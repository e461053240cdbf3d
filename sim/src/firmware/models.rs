//! Which twin stands for which part: holder, filter wheel and shutter of any model that has a driver.

use super::Firmware;
use super::esp301::Esp301Twin;
use super::fw212c::Fw212cTwin;
use super::ifw::IfwTwin;
use super::open_shutter::OpenShutterTwin;
use super::sc10::Sc10Twin;
use super::smc100::Smc100Twin;
use super::zaber::ZaberChainTwin;
use tokio::time::Instant;

/// A sample holder of any model.
#[derive(Debug)]
pub enum HolderTwin {
    /// Chain of Zaber stages.
    Zaber(ZaberChainTwin),
    /// Newport ESP300/ESP301.
    Esp301(Esp301Twin),
    /// Newport SMC100 boxes.
    Smc100(Smc100Twin),
}

/// A filter wheel of any model.
#[derive(Debug)]
pub enum WheelTwin {
    /// Thorlabs FW212C.
    Fw212c(Fw212cTwin),
    /// Optec IFW.
    Ifw(IfwTwin),
}

/// A shutter of any model.
#[derive(Debug)]
pub enum ShutterTwin {
    /// Thorlabs SC10.
    Sc10(Sc10Twin),
    /// A box without feedback.
    OpenLoop(OpenShutterTwin),
}

/// Hands every call of [`Firmware`] to the model.
macro_rules! speak_through {
    ($kind:ident: $($model:ident),+) => {
        impl Firmware for $kind {
            fn receive(&mut self, bytes: &[u8], now: Instant) {
                match self { $($kind::$model(twin) => twin.receive(bytes, now),)+ }
            }
            fn due(&self) -> Option<Instant> {
                match self { $($kind::$model(twin) => twin.due(),)+ }
            }
            fn take(&mut self, now: Instant) -> Vec<u8> {
                match self { $($kind::$model(twin) => twin.take(now),)+ }
            }
            fn connected(&mut self, now: Instant) {
                match self { $($kind::$model(twin) => twin.connected(now),)+ }
            }
        }
    };
}

speak_through!(HolderTwin: Zaber, Esp301, Smc100);
speak_through!(WheelTwin: Fw212c, Ifw);
speak_through!(ShutterTwin: Sc10, OpenLoop);

// === impl HolderTwin ===

impl HolderTwin {
    /// True while a fault waits for its occasion.
    pub fn faults_wait(&self) -> bool {
        match self {
            HolderTwin::Zaber(twin) => twin.faults_wait(),
            HolderTwin::Esp301(twin) => twin.faults_wait(),
            HolderTwin::Smc100(twin) => twin.faults_wait(),
        }
    }

    /// True angle of the stage with this number (device of a chain, axis of a controller); `None` where there is none.
    pub fn angle_deg(&self, number: u8, at: Instant) -> Option<f64> {
        match self {
            HolderTwin::Zaber(twin) => twin.angle_deg(number, at),
            HolderTwin::Esp301(twin) => twin.angle_deg(number, at),
            HolderTwin::Smc100(twin) => twin.angle_deg(number, at),
        }
    }
}

// === impl WheelTwin ===

impl WheelTwin {
    /// True while a fault waits for its occasion.
    pub fn faults_wait(&self) -> bool {
        match self {
            WheelTwin::Fw212c(twin) => twin.faults_wait(),
            WheelTwin::Ifw(twin) => twin.faults_wait(),
        }
    }

    /// The place that is really in the beam; `None` while the wheel turns.
    pub fn place(&self, at: Instant) -> Option<u8> {
        match self {
            WheelTwin::Fw212c(twin) => twin.place(at),
            WheelTwin::Ifw(twin) => twin.place(at),
        }
    }

    /// True while the wheel's own sensors shine at rest.
    pub fn sensors_on(&self) -> bool {
        matches!(self, WheelTwin::Fw212c(twin) if twin.sensors_on())
    }
}

// === impl ShutterTwin ===

impl ShutterTwin {
    /// True while a fault waits for its occasion.
    pub fn faults_wait(&self) -> bool {
        match self {
            ShutterTwin::Sc10(twin) => twin.faults_wait(),
            ShutterTwin::OpenLoop(_) => false,
        }
    }

    /// True when light passes.
    pub fn light_passes(&self, at: Instant) -> bool {
        match self {
            ShutterTwin::Sc10(twin) => twin.light_passes(at),
            ShutterTwin::OpenLoop(twin) => twin.light_passes(at),
        }
    }
}
