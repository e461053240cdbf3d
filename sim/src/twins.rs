//! The moving parts of the simulated bench together: holder chain, filter wheel, shutter, each on its port.

use crate::firmware::fw212c::{Fw212cTwin, WheelFault, WheelSpec};
use crate::firmware::sc10::{Sc10Twin, ShutterFault};
use crate::firmware::zaber::{ZaberChainTwin, ZaberFault, ZaberStage};
use crate::front::PipePort;
use crate::pose::{Pose, PoseSource};
use goniod_drivers::clock::Clock;
use goniod_drivers::transport::Connector;
use tokio::time::Instant;

/// Names of the simulated ports.
pub const PORTS: [&str; 3] = ["sim:holder", "sim:filter-wheel", "sim:shutter"];

/// What the bench's moving parts are.
#[derive(Debug, Clone, PartialEq)]
pub struct TwinsSpec {
    /// Stages of the holder's chain, device 1 first: tilt, spin and, where there is one, the changer.
    pub stages: Vec<ZaberStage>,
    /// The filter wheel.
    pub wheel: WheelSpec,
}

/// The moving parts, shared by drivers (through their ports) and cameras (through the true pose).
#[derive(Clone)]
pub struct Twins {
    /// Holder chain: device 1 tilts, 2 spins, 3 changes the sample.
    pub holder: PipePort<ZaberChainTwin>,
    /// Filter wheel.
    pub wheel: PipePort<Fw212cTwin>,
    /// Shutter.
    pub shutter: PipePort<Sc10Twin>,
}

/// A fault of any moving part, for schedules.
#[derive(Debug, Clone, PartialEq)]
pub enum Fault {
    /// Of the holder.
    Holder(ZaberFault),
    /// Of the wheel.
    Wheel(WheelFault),
    /// Of the shutter.
    Shutter(ShutterFault),
    /// The adapter of a port (`sim:holder`) is pulled out for so long.
    Unplugged(String, std::time::Duration),
}

// === impl TwinsSpec ===

impl TwinsSpec {
    /// Three stages with these serial numbers (tilt, spin, changer) and a twelve-place wheel.
    pub fn with_serials(tilt: &str, spin: &str, changer: &str) -> TwinsSpec {
        TwinsSpec { stages: [tilt, spin, changer].map(ZaberStage::new).into(), wheel: WheelSpec::default() }
    }
}

// === impl Twins ===

impl Twins {
    /// All parts powered up now.
    pub fn new(spec: TwinsSpec) -> Twins {
        let now = Instant::now();
        let [holder, wheel, shutter] = PORTS;
        Twins {
            holder: PipePort::new(holder, ZaberChainTwin::new(spec.stages, now)),
            wheel: PipePort::new(wheel, Fw212cTwin::new(spec.wheel, now)),
            shutter: PipePort::new(shutter, Sc10Twin::new(now)),
        }
    }

    /// The connector of a port name (`sim:holder`, `sim:filter-wheel`, `sim:shutter`); `None` for any other.
    pub fn connector(&self, port: &str, clock: Clock) -> Option<Box<dyn Connector>> {
        match port {
            "sim:holder" => Some(Box::new(self.holder.connector(clock))),
            "sim:filter-wheel" => Some(Box::new(self.wheel.connector(clock))),
            "sim:shutter" => Some(Box::new(self.shutter.connector(clock))),
            _ => None,
        }
    }

    /// Lets a fault happen, now or at its next occasion.
    pub fn inject(&self, fault: Fault) {
        let now = Instant::now();
        match fault {
            Fault::Holder(fault) => self.holder.with(|twin| twin.inject(fault, now)),
            Fault::Wheel(fault) => self.wheel.with(|twin| twin.inject(fault, now)),
            Fault::Shutter(fault) => self.shutter.with(|twin| twin.inject(fault, now)),
            Fault::Unplugged(port, time) => match port.as_str() {
                "sim:holder" => self.holder.unplug_for(time),
                "sim:filter-wheel" => self.wheel.unplug_for(time),
                "sim:shutter" => self.shutter.unplug_for(time),
                _ => tracing::warn!(port, "no such port on the simulated bench"),
            },
        }
    }
}

impl PoseSource for Twins {
    fn pose(&self, at: Instant) -> Pose {
        let angle = |device| self.holder.peek(|twin| twin.angle_deg(device, at)).unwrap_or(0.0);
        Pose {
            tilt_deg: angle(1),
            spin_deg: angle(2),
            changer_deg: angle(3),
            slot: self.wheel.peek(|twin| twin.place(at)),
            shutter_open: self.shutter.peek(|twin| twin.light_passes(at)),
        }
    }
}
