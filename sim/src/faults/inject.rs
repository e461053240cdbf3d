//! Lets the faults of a schedule happen on the bench, one after the other in simulated time, and counts those that
//! really happened: a fault of the next answer counts when that answer went out wrong.

use super::catalogue::{CameraKind, HolderKind, Kind, LineKind, Port, ShutterKind, WheelKind};
use super::schedule::{Entry, Schedule};
use crate::camera::{CameraFault, FaultQueue};
use crate::firmware::fw212c::WheelFault;
use crate::firmware::outbox::WireFault;
use crate::firmware::sc10::ShutterFault;
use crate::firmware::zaber::ZaberFault;
use crate::truth::rng::Key;
use crate::twins::{Fault, Twins};
use goniod_drivers::clock::Clock;
use std::collections::BTreeMap;
use std::fmt;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

/// Where faults go.
#[derive(Clone)]
pub struct Targets {
    /// Holder, wheel and shutter.
    pub twins: Twins,
    /// Frames of each camera.
    pub cameras: BTreeMap<String, FaultQueue>,
    /// Called with true when the operator pauses, with false when the night is to go on.
    pub pause: Arc<dyn Fn(bool) + Send + Sync>,
}

/// How often each kind really happened. Clones share the counts.
#[derive(Debug, Clone, Default)]
pub struct Counts(Arc<Mutex<BTreeMap<Kind, u32>>>);

/// Longest wait for an occasion; the next fault then comes on top.
const OCCASION: Duration = Duration::from_secs(300);
/// How often it is looked whether a fault has happened.
const LOOK: Duration = Duration::from_millis(200);

// === impl Counts ===

impl Counts {
    /// How often each kind happened.
    pub fn fired(&self) -> BTreeMap<Kind, u32> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// All together.
    pub fn total(&self) -> u32 {
        self.fired().values().sum()
    }

    fn count(&self, kind: Kind) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner).entry(kind).or_default() += 1;
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
        targets.inject(entry, clock);
        waiting.push(entry.kind);
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
    /// Lets one fault happen, now or at its next occasion.
    fn inject(&self, entry: Entry, clock: Clock) {
        let (twins, draw) = (&self.twins, entry.draw);
        match entry.kind {
            Kind::Line(port, kind) => self.line(port, kind, draw),
            Kind::LongUnplugged(port) => unplug(twins, port, seconds(900.0, 900.0, draw)),
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
                if let Some(queue) = self.camera(draw) {
                    queue.push(camera(kind, draw));
                }
            }
            Kind::Pause => {
                let pause = Arc::clone(&self.pause);
                pause(true);
                let time = seconds(30.0, 600.0, draw);
                tokio::spawn(async move {
                    clock.sleep(time).await;
                    pause(false);
                });
            }
        }
    }

    fn line(&self, port: Port, kind: LineKind, draw: Key) {
        let wire = |fault| match port {
            Port::Holder => Fault::Holder(ZaberFault::Wire(fault)),
            Port::Wheel => Fault::Wheel(WheelFault::Wire(fault)),
            Port::Shutter => Fault::Shutter(ShutterFault::Wire(fault)),
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
            },
            LineKind::RestartOnCommand => match port {
                Port::Holder => Fault::Holder(ZaberFault::RestartOnCommand),
                Port::Wheel => Fault::Wheel(WheelFault::RestartOnCommand),
                Port::Shutter => Fault::Shutter(ShutterFault::RestartOnCommand),
            },
            LineKind::Unplugged => return unplug(&self.twins, port, seconds(0.5, 6.0, draw)),
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
        tokio::spawn(async move {
            clock.sleep(seconds(1.0, 8.0, draw)).await;
            twins.inject(fault(false));
        });
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
            Kind::Camera(_) => self.cameras.values().any(|queue| !queue.is_empty()),
            Kind::Pause | Kind::LongUnplugged(_) => false,
        }
    }
}

fn unplug(twins: &Twins, port: Port, time: Duration) {
    let name = match port {
        Port::Holder => "sim:holder",
        Port::Wheel => "sim:filter-wheel",
        Port::Shutter => "sim:shutter",
    };
    twins.inject(Fault::Unplugged(name.to_owned(), time));
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
    }
}

/// Between `least` and `most` seconds.
fn seconds(least: f64, most: f64, draw: Key) -> Duration {
    Duration::from_secs_f64(least + (most - least) * draw.uniform(0))
}
