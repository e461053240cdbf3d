//! The serial devices of the simulated bench together, each of any model and on its port: holder, filter wheel, shutter,
//! monochromator, light monitor.

use crate::firmware::cm110::{Cm110Twin, MonochromatorFault, MonochromatorSpec};
use crate::firmware::esp301::{Esp301Fault, Esp301Twin, EspStage};
use crate::firmware::fw212c::{Fw212cTwin, WheelFault, WheelSpec};
use crate::firmware::ifw::{IfwFault, IfwTwin};
use crate::firmware::models::{HolderTwin, ShutterTwin, WheelTwin};
use crate::firmware::newport_1830c::{MonitorFault, Newport1830cTwin};
use crate::firmware::open_shutter::{Listener, OpenShutterFault, OpenShutterTwin};
use crate::firmware::sc10::{Sc10Twin, ShutterFault};
use crate::firmware::smc100::{Smc100Fault, Smc100Twin, SmcStage};
use crate::firmware::zaber::{ZaberChainTwin, ZaberFault, ZaberStage};
use crate::front::PipePort;
use crate::pose::{Pose, PoseSource};
use crate::truth::error::{Result, SimError};
use crate::truth::lamp::{LampFault, SimLamp};
use goniod_drivers::clock::Clock;
use goniod_drivers::transport::Connector;
use tokio::time::Instant;

/// Names of the simulated ports.
pub const PORTS: [&str; 5] =
    ["sim:holder", "sim:filter-wheel", "sim:shutter", "sim:monochromator", "sim:light-monitor"];

/// What the lamp puts on the light monitor before a bench's own lamp is looked at, watts.
const MONITOR_W: f64 = 1e-3;
/// Drivers whose devices have a twin: holders, wheels, shutters.
pub const DRIVERS: [&[&str]; 3] = [
    &["zaber-ascii", "newport-esp301", "newport-esp300", "newport-smc100"],
    &["thorlabs-fw212c", "optec-ifw"],
    &["thorlabs-sc10", "uniblitz-vcm-d1", "lcus-relay"],
];

/// What the bench's moving parts are.
#[derive(Debug, Clone, PartialEq)]
pub struct TwinsSpec {
    /// Stages of the holder, number 1 first: tilt, spin and, where there is one, the changer.
    pub stages: Vec<ZaberStage>,
    /// The filter wheel.
    pub wheel: WheelSpec,
    /// The monochromator.
    pub monochromator: MonochromatorSpec,
    /// Drivers that speak to holder, filter wheel and shutter: they say which models these are.
    pub drivers: [String; 3],
}

/// The moving parts, shared by drivers (through their ports) and cameras (through the true pose).
#[derive(Clone)]
pub struct Twins {
    /// Holder: stage 1 tilts, 2 spins, 3 changes the sample.
    pub holder: PipePort<HolderTwin>,
    /// Filter wheel.
    pub wheel: PipePort<WheelTwin>,
    /// Shutter.
    pub shutter: PipePort<ShutterTwin>,
    /// Monochromator of the calibration bench.
    pub monochromator: PipePort<Cm110Twin>,
    /// Light monitor; it looks at the lamp before the shutter.
    pub light_monitor: PipePort<Newport1830cTwin>,
}

/// A fault of any moving part, for schedules. A fault of a model that does not stand on the bench is logged and void.
#[derive(Debug, Clone, PartialEq)]
pub enum Fault {
    /// Of a Zaber holder.
    Holder(ZaberFault),
    /// Of an ESP301 holder.
    Esp301(Esp301Fault),
    /// Of an SMC100 holder.
    Smc100(Smc100Fault),
    /// Of a FW212C wheel.
    Wheel(WheelFault),
    /// Of an Optec wheel.
    Ifw(IfwFault),
    /// Of a SC10 shutter.
    Shutter(ShutterFault),
    /// Of a shutter without feedback.
    OpenShutter(OpenShutterFault),
    /// Of the monochromator.
    Monochromator(MonochromatorFault),
    /// Of the light monitor.
    LightMonitor(MonitorFault),
    /// Of the lamp.
    Lamp(LampFault),
    /// The adapter of a port (`sim:holder`) is pulled out for so long.
    Unplugged(String, std::time::Duration),
    /// A port (`sim:holder`) hangs for so long.
    Stuck(String, std::time::Duration),
}

// === impl TwinsSpec ===

impl TwinsSpec {
    /// Three stages with these serial numbers (tilt, spin, changer) and a twelve-place wheel.
    pub fn with_serials(tilt: &str, spin: &str, changer: &str) -> TwinsSpec {
        let stages = [tilt, spin, changer].map(ZaberStage::new).into();
        let drivers = ["zaber-ascii", "thorlabs-fw212c", "thorlabs-sc10"].map(str::to_owned);
        TwinsSpec { stages, wheel: WheelSpec::default(), monochromator: MonochromatorSpec::default(), drivers }
    }

    /// The same parts as other models: those that these drivers (holder, wheel, shutter) speak to.
    ///
    /// # Errors
    /// [`SimError::Unknown`]: a driver whose device has no twin.
    pub fn with_drivers(mut self, drivers: [&str; 3]) -> Result<TwinsSpec> {
        for (driver, known) in drivers.iter().zip(DRIVERS) {
            if !known.contains(driver) {
                let (name, known) = ((*driver).to_owned(), known.join(", "));
                return Err(SimError::Unknown { what: "device in software for the driver", name, known });
            }
        }
        self.drivers = drivers.map(str::to_owned);
        Ok(self)
    }

    /// The holder, powered up at `now`.
    pub fn holder(&self, now: Instant) -> HolderTwin {
        let esp = |s: &ZaberStage| EspStage { start_deg: s.start_deg, ..EspStage::new(&s.serial) };
        let smc = |(n, s): (usize, &ZaberStage)| SmcStage {
            start_deg: s.start_deg,
            ..SmcStage::new((n + 1).min(31) as u8, &s.serial)
        };
        match self.drivers[0].as_str() {
            name @ ("newport-esp301" | "newport-esp300") => {
                let baud = if name == "newport-esp300" { 19_200 } else { 921_600 };
                HolderTwin::Esp301(Esp301Twin::new(self.stages.iter().map(esp).collect(), baud, now))
            }
            "newport-smc100" => {
                HolderTwin::Smc100(Smc100Twin::new(self.stages.iter().enumerate().map(smc).collect(), now))
            }
            _ => HolderTwin::Zaber(ZaberChainTwin::new(self.stages.clone(), now)),
        }
    }

    /// The filter wheel, powered up at `now`.
    pub fn wheel(&self, now: Instant) -> WheelTwin {
        match self.drivers[1].as_str() {
            "optec-ifw" => WheelTwin::Ifw(IfwTwin::new(self.wheel.places, now)),
            _ => WheelTwin::Fw212c(Fw212cTwin::new(self.wheel.clone(), now)),
        }
    }

    /// The shutter, powered up at `now`.
    pub fn shutter(&self, now: Instant) -> ShutterTwin {
        match self.drivers[2].as_str() {
            "uniblitz-vcm-d1" => ShutterTwin::OpenLoop(OpenShutterTwin::new(Listener::Uniblitz, now)),
            "lcus-relay" => ShutterTwin::OpenLoop(OpenShutterTwin::new(Listener::Relay, now)),
            _ => ShutterTwin::Sc10(Sc10Twin::new(now)),
        }
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
            holder: PipePort::new(holder, spec.holder(now)),
            wheel: PipePort::new(wheel, spec.wheel(now)),
            shutter: PipePort::new(shutter, spec.shutter(now)),
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
        let absent = |what: &str| tracing::warn!(what, "a fault of a model that is not on the simulated bench");
        match fault {
            Fault::Monochromator(fault) => self.monochromator.with(|twin| twin.inject(fault, now)),
            Fault::LightMonitor(fault) => self.light_monitor.with(|twin| twin.inject(fault, now)),
            Fault::Lamp(fault) => self.light_monitor.peek(|twin| twin.lamp().inject(fault, now)),
            Fault::Holder(_) | Fault::Esp301(_) | Fault::Smc100(_) => {
                self.holder.with(|twin| match (twin, fault) {
                    (HolderTwin::Zaber(twin), Fault::Holder(fault)) => twin.inject(fault, now),
                    (HolderTwin::Esp301(twin), Fault::Esp301(fault)) => twin.inject(fault, now),
                    (HolderTwin::Smc100(twin), Fault::Smc100(fault)) => twin.inject(fault, now),
                    _ => absent("holder"),
                });
            }
            Fault::Wheel(_) | Fault::Ifw(_) => self.wheel.with(|twin| match (twin, fault) {
                (WheelTwin::Fw212c(twin), Fault::Wheel(fault)) => twin.inject(fault, now),
                (WheelTwin::Ifw(twin), Fault::Ifw(fault)) => twin.inject(fault, now),
                _ => absent("filter wheel"),
            }),
            Fault::Shutter(_) | Fault::OpenShutter(_) => self.shutter.with(|twin| match (twin, fault) {
                (ShutterTwin::Sc10(twin), Fault::Shutter(fault)) => twin.inject(fault, now),
                (ShutterTwin::OpenLoop(twin), Fault::OpenShutter(fault)) => twin.inject(fault, now),
                _ => absent("shutter"),
            }),
            Fault::Unplugged(port, time) => match port.as_str() {
                "sim:holder" => self.holder.unplug_for(time),
                "sim:filter-wheel" => self.wheel.unplug_for(time),
                "sim:shutter" => self.shutter.unplug_for(time),
                "sim:monochromator" => self.monochromator.unplug_for(time),
                "sim:light-monitor" => self.light_monitor.unplug_for(time),
                _ => tracing::warn!(port, "no such port on the simulated bench"),
            },
            Fault::Stuck(port, time) => match port.as_str() {
                "sim:holder" => self.holder.stick_for(time),
                "sim:filter-wheel" => self.wheel.stick_for(time),
                "sim:shutter" => self.shutter.stick_for(time),
                "sim:monochromator" => self.monochromator.stick_for(time),
                "sim:light-monitor" => self.light_monitor.stick_for(time),
                _ => tracing::warn!(port, "no such port on the simulated bench"),
            },
        }
    }
}

impl PoseSource for Twins {
    fn pose(&self, at: Instant) -> Pose {
        let angle = |number| self.holder.peek(|twin| twin.angle_deg(number, at)).unwrap_or(0.0);
        Pose {
            tilt_deg: angle(1),
            spin_deg: angle(2),
            changer_deg: angle(3),
            slot: self.wheel.peek(|twin| twin.place(at)),
            shutter_open: self.shutter.peek(|twin| twin.light_passes(at)),
        }
    }
}
