//! The serial devices of the simulated bench together, each on its port: holder chain, filter wheel, shutter,
//! monochromator, light monitor.

use crate::firmware::cm110::{Cm110Twin, MonochromatorFault, MonochromatorSpec};
use crate::firmware::fw212c::{Fw212cTwin, WheelFault, WheelSpec};
use crate::firmware::newport_1830c::{MonitorFault, Newport1830cTwin};
use crate::firmware::sc10::{Sc10Twin, ShutterFault};
use crate::firmware::zaber::{ZaberChainTwin, ZaberFault, ZaberStage};
use crate::front::PipePort;
use crate::pose::{Pose, PoseSource};
use crate::truth::lamp::{LampFault, SimLamp};
use goniod_drivers::clock::Clock;
use goniod_drivers::transport::Connector;
use tokio::time::Instant;

/// Names of the simulated ports.
pub const PORTS: [&str; 5] =
    ["sim:holder", "sim:filter-wheel", "sim:shutter", "sim:monochromator", "sim:light-monitor"];

/// What the lamp puts on the light monitor before a bench's own lamp is looked at, watts.
const MONITOR_W: f64 = 1e-3;

/// What the bench's moving parts are.
#[derive(Debug, Clone, PartialEq)]
pub struct TwinsSpec {
    /// Stages of the holder's chain, device 1 first: tilt, spin and, where there is one, the changer.
    pub stages: Vec<ZaberStage>,
    /// The filter wheel.
    pub wheel: WheelSpec,
    /// The monochromator.
    pub monochromator: MonochromatorSpec,
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
    /// Monochromator of the calibration bench.
    pub monochromator: PipePort<Cm110Twin>,
    /// Light monitor; it looks at the lamp before the shutter.
    pub light_monitor: PipePort<Newport1830cTwin>,
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
    /// Of the monochromator.
    Monochromator(MonochromatorFault),
    /// Of the light monitor.
    LightMonitor(MonitorFault),
    /// Of the lamp.
    Lamp(LampFault),
    /// The adapter of a port (`sim:holder`) is pulled out for so long.
    Unplugged(String, std::time::Duration),
}

// === impl TwinsSpec ===

impl TwinsSpec {
    /// Three stages with these serial numbers (tilt, spin, changer) and a twelve-place wheel.
    pub fn with_serials(tilt: &str, spin: &str, changer: &str) -> TwinsSpec {
        let stages = [tilt, spin, changer].map(ZaberStage::new).into();
        TwinsSpec { stages, wheel: WheelSpec::default(), monochromator: MonochromatorSpec::default() }
    }
}

// === impl Twins ===

impl Twins {
    /// All parts powered up now.
    pub fn new(spec: TwinsSpec) -> Twins {
        let now = Instant::now();
        let [holder, wheel, shutter, monochromator, light_monitor] = PORTS;
        let lamp = SimLamp::steady(MONITOR_W, now);
        Twins {
            holder: PipePort::new(holder, ZaberChainTwin::new(spec.stages, now)),
            wheel: PipePort::new(wheel, Fw212cTwin::new(spec.wheel, now)),
            shutter: PipePort::new(shutter, Sc10Twin::new(now)),
            monochromator: PipePort::new(monochromator, Cm110Twin::new(spec.monochromator, now)),
            light_monitor: PipePort::new(light_monitor, Newport1830cTwin::new(lamp, now)),
        }
    }

    /// The light monitor looks at this lamp, and lamp faults happen to it.
    pub fn look_at(&self, lamp: &SimLamp) {
        self.light_monitor.with(|twin| twin.look_at(lamp.clone()));
    }

    /// The connector of a port name (one of [`PORTS`]); `None` for any other.
    pub fn connector(&self, port: &str, clock: Clock) -> Option<Box<dyn Connector>> {
        match port {
            "sim:holder" => Some(Box::new(self.holder.connector(clock))),
            "sim:filter-wheel" => Some(Box::new(self.wheel.connector(clock))),
            "sim:shutter" => Some(Box::new(self.shutter.connector(clock))),
            "sim:monochromator" => Some(Box::new(self.monochromator.connector(clock))),
            "sim:light-monitor" => Some(Box::new(self.light_monitor.connector(clock))),
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
            Fault::Monochromator(fault) => self.monochromator.with(|twin| twin.inject(fault, now)),
            Fault::LightMonitor(fault) => self.light_monitor.with(|twin| twin.inject(fault, now)),
            Fault::Lamp(fault) => self.light_monitor.peek(|twin| twin.lamp().inject(fault, now)),
            Fault::Unplugged(port, time) => match port.as_str() {
                "sim:holder" => self.holder.unplug_for(time),
                "sim:filter-wheel" => self.wheel.unplug_for(time),
                "sim:shutter" => self.shutter.unplug_for(time),
                "sim:monochromator" => self.monochromator.unplug_for(time),
                "sim:light-monitor" => self.light_monitor.unplug_for(time),
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
