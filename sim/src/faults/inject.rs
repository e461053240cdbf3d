//! Lets the faults of a schedule happen on the bench, one after the other in simulated time, and counts those that
//! really happened: a fault of the next answer counts when that answer went out wrong.

use super::catalogue::{
    CameraKind, DiskKind, HolderKind, Kind, LampKind, LineKind, MonitorKind, OperatorKind, Port, ProcessKind,
    ShutterKind, WheelKind,
};
use super::schedule::{Entry, Schedule};
use crate::camera::{CameraFault, FaultQueue};
use crate::firmware::fw212c::WheelFault;
use crate::firmware::newport_1830c::MonitorFault;
use crate::firmware::outbox::WireFault;
use crate::firmware::sc10::ShutterFault;
use crate::firmware::zaber::ZaberFault;
use crate::truth::lamp::LampFault;
use crate::truth::rng::Key;
use crate::twins::{Fault, Twins};
use goniod_drivers::clock::Clock;
use std::collections::BTreeMap;
use std::fmt;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// Where faults go.
#[derive(Clone)]
pub struct Targets {
    /// Holder, wheel and shutter.
    pub twins: Twins,
    /// Frames of each camera.
    pub cameras: BTreeMap<String, FaultQueue>,
    /// What is around the bench; tells whether it could be done.
    pub around: Arc<dyn Fn(Around) -> bool + Send + Sync>,
}

/// What happens around the bench.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Around {
    /// This is asked of the run.
    Ask(Wish),
    /// A second daemon wants the run; done when it is refused.
    SecondDaemon,
    /// The files that the run was started from are edited.
    Edit,
    /// The disk is so from now on, or no longer.
    Disk(DiskKind, bool),
    /// The process ends.
    Process(ProcessKind),
}

/// What an operator asks of a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Wish {
    /// To pause after the exposure under way.
    Pause,
    /// To pause at once.
    PauseNow,
    /// To go on.
    Resume,
    /// To end after the exposure under way.
    Stop,
    /// To end at once.
    Abort,
    /// To be safe at once.
    Safe,
}

/// How often each kind really happened. Clones share the counts.
#[derive(Debug, Clone, Default)]
pub struct Counts(Arc<Mutex<Counted>>);

#[derive(Debug, Default)]
struct Counted {
    fired: BTreeMap<Kind, u32>,
    begun: usize,
}

/// Longest wait for an occasion; the next fault then comes on top.
const OCCASION: Duration = Duration::from_secs(300);
/// How often it is looked whether a fault has happened.
const LOOK: Duration = Duration::from_millis(200);

// === impl Counts ===

impl Counts {
    /// How often each kind happened.
    pub fn fired(&self) -> BTreeMap<Kind, u32> {
        self.counted().fired.clone()
    }

    /// Faults of the schedule that were begun, whether or not they found their occasion.
    pub fn begun(&self) -> usize {
        self.counted().begun
    }

    /// All together.
    pub fn total(&self) -> u32 {
        self.fired().values().sum()
    }

    fn begin(&self) {
        self.counted().begun += 1;
    }

    fn count(&self, kind: Kind) {
        *self.counted().fired.entry(kind).or_default() += 1;
    }

    fn counted(&self) -> MutexGuard<'_, Counted> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl fmt::Display for Counts {
    /// `3 faults: camera: black 1, wheel: stuck 2`
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let fired = self.fired();
        write!(f, "{} faults", fired.values().sum::<u32>())?;
        for (i, (kind, n)) in fired.iter().enumerate() {
            write!(f, "{} {kind} {n}", if i == 0 { ":" } else { "," })?;
        }
        Ok(())
    }
}

/// Carries a schedule out; ends after its last fault, or never when the bench gives no more occasion.
pub async fn carry_out(schedule: Schedule, targets: Targets, clock: Clock, counts: Counts) {
    let begin = clock.now();
    let mut waiting: Vec<Kind> = Vec::new();
    let mut entries = schedule.entries.into_iter().peekable();
    while let Some(entry) = entries.next() {
        clock.sleep_until(begin + entry.at).await;
        counts.begin();
        if targets.inject(entry, clock) {
            waiting.push(entry.kind);
        }
        if entries.peek().is_some_and(|next| next.at == entry.at) {
            continue;
        }
        let limit = clock.now() + OCCASION;
        loop {
            // Each fault is looked at by its device; those that have none of theirs waiting have happened.
            waiting.retain(|kind| {
                let happened = !targets.waits(*kind);
                if happened {
                    counts.count(*kind);
                }
                !happened
            });
            if waiting.is_empty() || clock.now() >= limit {
                break;
            }
            clock.sleep(LOOK).await;
        }
        waiting.clear();
    }
}

// === impl Targets ===

impl Targets {
    /// Lets one fault happen, now or at its next occasion; false when it cannot.
    fn inject(&self, entry: Entry, clock: Clock) -> bool {
        let (twins, draw) = (&self.twins, entry.draw);
        match entry.kind {
            Kind::Line(port, kind) => self.line(port, kind, draw),
            Kind::LongUnplugged(port) => unplug(twins, port, seconds(900.0, 3600.0, draw)),
            Kind::Holder(kind) => twins.inject(Fault::Holder(holder(kind, draw, twins, clock))),
            Kind::Wheel(kind) => match kind {
                WheelKind::OffByOne => twins.inject(Fault::Wheel(WheelFault::Button(1))),
                WheelKind::EarlyDone => twins.inject(Fault::Wheel(WheelFault::PromptEarly)),
                WheelKind::PlaceUntold => {
                    // Asked while it turns, which only an early prompt brings about.
                    twins.inject(Fault::Wheel(WheelFault::PositionEmpty));
                    twins.inject(Fault::Wheel(WheelFault::PromptEarly));
                }
                WheelKind::Stuck => self.passing(clock, draw, |on| Fault::Wheel(WheelFault::Jam(on))),
            },
            Kind::Shutter(kind) => self.shutter(kind, draw, clock),
            Kind::Camera(kind) => {
                let queue = self.camera(draw);
                queue.inspect(|queue| queue.push(camera(kind, draw)));
                return queue.is_some();
            }
            Kind::Monitor(kind) => self.monitor(kind, draw),
            Kind::Lamp(kind) => self.lamp(kind, draw, clock),
            Kind::Operator(kind) => return self.operator(kind, draw, clock),
            Kind::Disk(kind @ (DiskKind::Fails | DiskKind::SyncFails)) => {
                return (self.around)(Around::Disk(kind, true));
            }
            Kind::Disk(kind) => {
                let around = Arc::clone(&self.around);
                let time = seconds(5.0, 300.0, draw);
                later(clock, time, move || around(Around::Disk(kind, false)));
                return (self.around)(Around::Disk(kind, true));
            }
            Kind::Process(ProcessKind::Panics) => {
                let queue = self.camera(draw);
                queue.inspect(|queue| queue.push(CameraFault::Panic));
                return queue.is_some();
            }
            Kind::Process(kind) => return (self.around)(Around::Process(kind)),
        }
        true
    }

    fn monitor(&self, kind: MonitorKind, draw: Key) {
        let now = |fault| self.twins.inject(Fault::LightMonitor(fault));
        match kind {
            MonitorKind::Hold => now(MonitorFault::Hold),
            MonitorKind::Wavelength => now(MonitorFault::FrontWavelength(400 + (draw.bits(1) % 700) as u16)),
            MonitorKind::Units => now(MonitorFault::FrontUnits(2 + (draw.bits(1) % 3) as u8)),
            MonitorKind::Swallowed => {
                // Settings are made after a restart only.
                now(MonitorFault::SettingSwallowed);
                now(MonitorFault::Restart);
            }
        }
    }

    fn operator(&self, kind: OperatorKind, draw: Key, clock: Clock) -> bool {
        let ask = |wish| (self.around)(Around::Ask(wish));
        let resume_later = || {
            let around = Arc::clone(&self.around);
            later(clock, seconds(30.0, 600.0, draw), move || around(Around::Ask(Wish::Resume)));
        };
        match kind {
            OperatorKind::Pause => {
                resume_later();
                ask(Wish::Pause)
            }
            OperatorKind::PauseNow => {
                resume_later();
                ask(Wish::PauseNow)
            }
            OperatorKind::Flurry => [Wish::Pause, Wish::Resume, Wish::PauseNow, Wish::Resume].into_iter().all(ask),
            OperatorKind::Stop => ask(Wish::Stop),
            OperatorKind::Abort => ask(Wish::Abort),
            OperatorKind::Safe => ask(Wish::Safe),
            OperatorKind::SecondDaemon => (self.around)(Around::SecondDaemon),
            OperatorKind::Edit => (self.around)(Around::Edit),
        }
    }

    /// Lamp faults pass: what is lost comes back.
    fn lamp(&self, kind: LampKind, draw: Key, clock: Clock) {
        let twins = self.twins.clone();
        let lamp = move |fault| twins.inject(Fault::Lamp(fault));
        let minutes = |n: f64| Duration::from_secs_f64(60.0 * n);
        let sign = if draw.bits(1).is_multiple_of(2) { 1.0 } else { -1.0 };
        match kind {
            LampKind::Off => {
                lamp(LampFault::Off);
                // Its arc can be struck again when it is cold.
                later(clock, minutes(11.0 + 4.0 * draw.uniform(2)), move || lamp(LampFault::Strike));
            }
            LampKind::Jump => {
                let by = sign * (0.015 + 0.03 * draw.uniform(2));
                lamp(LampFault::Jump(by));
                later(clock, minutes(0.5 + 4.0 * draw.uniform(3)), move || {
                    lamp(LampFault::Jump(1.0 / (1.0 + by) - 1.0))
                });
            }
            LampKind::Drift => {
                // Percent within a bracket.
                let per_hour = sign * (0.5 + draw.uniform(2));
                let time = minutes(1.0 + draw.uniform(3));
                lamp(LampFault::Drift(per_hour));
                let by = per_hour * time.as_secs_f64() / 3600.0;
                later(clock, time, move || {
                    lamp(LampFault::Drift(0.0));
                    lamp(LampFault::Jump(1.0 / (1.0 + by) - 1.0));
                });
            }
            LampKind::Flicker => {
                lamp(LampFault::Flicker(0.002 + 0.003 * draw.uniform(2)));
                later(clock, minutes(1.0 + 4.0 * draw.uniform(3)), move || lamp(LampFault::Flicker(0.0)));
            }
        }
    }

    fn line(&self, port: Port, kind: LineKind, draw: Key) {
        let wire = |fault| match port {
            Port::Holder => Fault::Holder(ZaberFault::Wire(fault)),
            Port::Wheel => Fault::Wheel(WheelFault::Wire(fault)),
            Port::Shutter => Fault::Shutter(ShutterFault::Wire(fault)),
            Port::LightMonitor => Fault::LightMonitor(MonitorFault::Wire(fault)),
        };
        let place = draw.bits(1) as usize % 64;
        let fault = match kind {
            LineKind::Garbage => {
                wire(WireFault::Junk((0..4 + place as u64 % 5).map(|i| draw.bits(9 + i) as u8).collect()))
            }
            LineKind::ChangedByte => wire(WireFault::Corrupt(place, 1 << (draw.bits(2) % 7))),
            LineKind::LostByte => wire(WireFault::Drop(place)),
            LineKind::Cut => wire(WireFault::Cut(place % 8)),
            LineKind::Doubled => wire(WireFault::Duplicate),
            LineKind::Late => wire(WireFault::Late(seconds(0.5, 8.0, draw))),
            LineKind::Previous => wire(WireFault::Previous),
            LineKind::Silence => wire(WireFault::NoReply),
            LineKind::Restart => match port {
                Port::Holder => Fault::Holder(ZaberFault::Restart(1 + (draw.bits(3) % 3) as u8)),
                Port::Wheel => Fault::Wheel(WheelFault::Restart),
                Port::Shutter => Fault::Shutter(ShutterFault::Restart),
                Port::LightMonitor => Fault::LightMonitor(MonitorFault::Restart),
            },
            LineKind::RestartOnCommand => match port {
                Port::Holder => Fault::Holder(ZaberFault::RestartOnCommand),
                Port::Wheel => Fault::Wheel(WheelFault::RestartOnCommand),
                Port::Shutter => Fault::Shutter(ShutterFault::RestartOnCommand),
                Port::LightMonitor => Fault::LightMonitor(MonitorFault::RestartOnCommand),
            },
            LineKind::Unplugged => Fault::Unplugged(name(port).to_owned(), seconds(0.5, 6.0, draw)),
            LineKind::Stuck => Fault::Stuck(name(port).to_owned(), seconds(2.0, 20.0, draw)),
        };
        self.twins.inject(fault);
    }

    fn shutter(&self, kind: ShutterKind, draw: Key, clock: Clock) {
        let now = |fault| self.twins.inject(Fault::Shutter(fault));
        match kind {
            ShutterKind::Stuck => self.passing(clock, draw, |on| Fault::Shutter(ShutterFault::Stuck(on))),
            ShutterKind::Interlock => self.passing(clock, draw, |on| Fault::Shutter(ShutterFault::Interlock(on))),
            ShutterKind::Key => now(ShutterFault::FrontKey),
            ShutterKind::Mode => now(ShutterFault::Mode(2 + (draw.bits(4) % 3) as u8)),
            ShutterKind::EchoLost => now(ShutterFault::EchoLost),
            ShutterKind::PromptLost => now(ShutterFault::PromptLostAfterToggle),
            ShutterKind::Swallowed => now(ShutterFault::FirstSwallowed),
        }
    }

    /// A fault that holds for some seconds.
    fn passing(&self, clock: Clock, draw: Key, fault: impl Fn(bool) -> Fault + Send + 'static) {
        let twins = self.twins.clone();
        twins.inject(fault(true));
        later(clock, seconds(1.0, 8.0, draw), move || twins.inject(fault(false)));
    }

    fn camera(&self, draw: Key) -> Option<&FaultQueue> {
        let count = self.cameras.len().max(1) as u64;
        self.cameras.values().nth((draw.bits(5) % count) as usize)
    }

    /// True while a fault of this kind still waits for its occasion.
    fn waits(&self, kind: Kind) -> bool {
        match kind {
            Kind::Line(Port::Holder, _) | Kind::Holder(_) => self.twins.holder.peek(|t| t.faults_wait()),
            Kind::Line(Port::Wheel, _) | Kind::Wheel(_) => self.twins.wheel.peek(|t| t.faults_wait()),
            Kind::Line(Port::Shutter, _) | Kind::Shutter(_) => self.twins.shutter.peek(|t| t.faults_wait()),
            Kind::Line(Port::LightMonitor, _) | Kind::Monitor(_) => self.twins.light_monitor.peek(|t| t.faults_wait()),
            Kind::Camera(_) | Kind::Process(ProcessKind::Panics) => {
                self.cameras.values().any(|queue| !queue.is_empty())
            }
            Kind::Lamp(_) | Kind::Operator(_) | Kind::Disk(_) | Kind::Process(_) | Kind::LongUnplugged(_) => false,
        }
    }
}

fn unplug(twins: &Twins, port: Port, time: Duration) {
    twins.inject(Fault::Unplugged(name(port).to_owned(), time));
}

fn name(port: Port) -> &'static str {
    match port {
        Port::Holder => "sim:holder",
        Port::Wheel => "sim:filter-wheel",
        Port::Shutter => "sim:shutter",
        Port::LightMonitor => "sim:light-monitor",
    }
}

/// Does something after `time`; whether it could be done then matters to nobody.
fn later<T>(clock: Clock, time: Duration, act: impl FnOnce() -> T + Send + 'static) {
    tokio::spawn(async move {
        clock.sleep(time).await;
        let _ = act();
    });
}

fn holder(kind: HolderKind, draw: Key, twins: &Twins, clock: Clock) -> ZaberFault {
    let device = 1 + (draw.bits(6) % 2) as u8;
    match kind {
        HolderKind::Busy => ZaberFault::Again(1 + (draw.bits(7) % 3) as u8),
        HolderKind::WrongId => ZaberFault::WrongId,
        HolderKind::WrongChecksum => ZaberFault::WrongLrc,
        HolderKind::Alert => ZaberFault::AlertBetween,
        HolderKind::Stall => {
            let at = twins.holder.peek(|t| t.angle_deg(device, clock.now())).unwrap_or(0.0);
            // A little beside where it stands, on the side where there is way: the next move that way passes it.
            let way = if at > 90.0 { -1.0 } else { 1.0 };
            ZaberFault::Stall(device, at + way * (0.5 + 2.0 * draw.uniform(8)))
        }
        HolderKind::Pushed => ZaberFault::Displaced(device, 0.5 + 3.0 * draw.uniform(8)),
        HolderKind::Knob => ZaberFault::Knob(device, 0.5 + 3.0 * draw.uniform(8)),
        HolderKind::DriveOff => ZaberFault::DriverOff(device),
        HolderKind::NeverArrives => ZaberFault::NeverArrives(device),
    }
}

fn camera(kind: CameraKind, draw: Key) -> CameraFault {
    match kind {
        CameraKind::NoFrame => CameraFault::NoFrame,
        CameraKind::Late => CameraFault::Late(seconds(0.5, 6.0, draw)),
        CameraKind::Stale => CameraFault::Stale,
        CameraKind::Repeated => CameraFault::Repeated,
        CameraKind::Black => CameraFault::Black,
        CameraKind::Truncated => CameraFault::Truncated,
        CameraKind::SkippedId => CameraFault::SkippedId,
        CameraKind::Hang => CameraFault::Hang,
        CameraKind::Lost => CameraFault::Lost,
        CameraKind::Forgets => CameraFault::Forgets,
        CameraKind::NotTaken => CameraFault::NotTaken,
    }
}

/// Between `least` and `most` seconds.
fn seconds(least: f64, most: f64, draw: Key) -> Duration {
    Duration::from_secs_f64(least + (most - least) * draw.uniform(0))
}
