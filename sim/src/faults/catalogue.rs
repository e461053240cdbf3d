//! Every kind of fault a fault plan may hold: over all devices of the bench, and over what is around it.
//!
//! Left out are lies that no answer and no picture gives away: a wheel that has lost count and does not know it, a shutter
//! sensor stuck at "open", a sensor that integrates another time over a scene without light. Where they can be seen, the
//! tests of drivers and labels show it.

use std::fmt;

/// A serial port of the bench.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Port {
    /// Holder chain.
    Holder,
    /// Filter wheel.
    Wheel,
    /// Shutter controller.
    Shutter,
    /// Light monitor.
    LightMonitor,
}

/// What may happen to any serial line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum LineKind {
    /// Bytes of noise before an answer.
    Garbage,
    /// A byte of an answer is changed.
    ChangedByte,
    /// A byte of an answer is lost.
    LostByte,
    /// An answer ends too early.
    Cut,
    /// An answer comes twice.
    Doubled,
    /// An answer comes later than a device may take.
    Late,
    /// The answer to the command before comes again.
    Previous,
    /// No answer.
    Silence,
    /// The controller restarts: its position and settings are lost.
    Restart,
    /// The next command makes the controller restart, without an answer.
    RestartOnCommand,
    /// The adapter is pulled out and put back some seconds later.
    Unplugged,
    /// The port hangs for some seconds: nothing passes, and whoever opens it waits.
    Stuck,
}

/// What may happen to the holder.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum HolderKind {
    /// Requests are rejected for a moment.
    Busy,
    /// An answer carries another request's number.
    WrongId,
    /// An answer's checksum is wrong.
    WrongChecksum,
    /// An alert comes between request and answer.
    Alert,
    /// A stage stalls on its way.
    Stall,
    /// A standing stage is pushed.
    Pushed,
    /// Somebody turns a stage's knob.
    Knob,
    /// A stage's drive goes off.
    DriveOff,
    /// A move never ends.
    NeverArrives,
}

/// What may happen to the filter wheel.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum WheelKind {
    /// It jams for some seconds.
    Stuck,
    /// Somebody presses its button: one place off.
    OffByOne,
    /// It says "done" before it stands.
    EarlyDone,
    /// It says "done" before it stands and cannot tell its place while it turns.
    PlaceUntold,
}

/// What may happen to the shutter.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum ShutterKind {
    /// The blade sticks for some seconds.
    Stuck,
    /// Somebody presses its key.
    Key,
    /// Somebody leaves another mode.
    Mode,
    /// Its interlock trips for some seconds.
    Interlock,
    /// A command is not echoed.
    EchoLost,
    /// A toggle is carried out, its prompt does not come.
    PromptLost,
    /// A command is swallowed whole.
    Swallowed,
}

/// What may happen to a camera.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum CameraKind {
    /// A frame never comes.
    NoFrame,
    /// A frame comes late.
    Late,
    /// An old picture comes under a new number.
    Stale,
    /// A frame comes again, with its old number and time.
    Repeated,
    /// A frame is black.
    Black,
    /// A frame is cut off.
    Truncated,
    /// Frame numbers are skipped.
    SkippedId,
    /// The camera does not answer any more, until it is opened anew.
    Hang,
    /// The camera is gone until it is opened anew.
    Lost,
    /// The camera is gone and comes back with its default settings.
    Forgets,
    /// A setting is swallowed: the registers keep the exposure before.
    NotTaken,
}

/// What may happen to the light monitor, besides its line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum MonitorKind {
    /// Somebody presses its hold key: the reading stands still.
    Hold,
    /// Somebody sets another wavelength.
    Wavelength,
    /// Somebody sets other units.
    Units,
    /// A setting is swallowed.
    Swallowed,
}

/// What may happen to the lamp.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum LampKind {
    /// It goes out, and is struck again when its arc is cold.
    Off,
    /// Its arc jumps, and back some minutes later.
    Jump,
    /// It drifts fast for a minute or two, and back.
    Drift,
    /// It flickers for some minutes.
    Flicker,
}

/// What people do while the night runs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum OperatorKind {
    /// A pause of some minutes after the exposure under way.
    Pause,
    /// A pause at once of some minutes.
    PauseNow,
    /// Pause, resume, pause now, resume, all in one breath.
    Flurry,
    /// Stop, as SIGTERM asks for; the run is gone on with later.
    Stop,
    /// Abort; the run is gone on with later.
    Abort,
    /// Safe; the run is gone on with later.
    Safe,
    /// A second daemon wants the same run.
    SecondDaemon,
    /// Somebody edits the files that the run was started from.
    Edit,
}

/// What may happen to the run's disk.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum DiskKind {
    /// It is slow for some seconds.
    Slow,
    /// It is full for some minutes.
    Full,
    /// An operation gives EIO.
    Fails,
    /// An fsync gives EIO.
    SyncFails,
}

/// What may happen to the process; the run is gone on with by another one.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum ProcessKind {
    /// It is killed.
    Killed,
    /// It panics in the driver of a camera.
    Panics,
    /// It is killed, and the wall clock is an hour earlier when the next one begins.
    ClockBack,
    /// The same, an hour later.
    ClockForward,
}

/// One kind of fault.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Kind {
    /// Of a serial line and the controller behind it.
    Line(Port, LineKind),
    /// Of the holder.
    Holder(HolderKind),
    /// Of the filter wheel.
    Wheel(WheelKind),
    /// Of the shutter.
    Shutter(ShutterKind),
    /// Of a camera.
    Camera(CameraKind),
    /// Of the light monitor.
    Monitor(MonitorKind),
    /// Of the lamp; only a light monitor tells it.
    Lamp(LampKind),
    /// Of people.
    Operator(OperatorKind),
    /// Of the run's disk.
    Disk(DiskKind),
    /// Of the process.
    Process(ProcessKind),
    /// An adapter stays away for many minutes.
    LongUnplugged(Port),
}

const LINE: [LineKind; 12] = [
    LineKind::Garbage,
    LineKind::ChangedByte,
    LineKind::LostByte,
    LineKind::Cut,
    LineKind::Doubled,
    LineKind::Late,
    LineKind::Previous,
    LineKind::Silence,
    LineKind::Restart,
    LineKind::RestartOnCommand,
    LineKind::Unplugged,
    LineKind::Stuck,
];
/// Lines without which no exposure is taken.
const PORTS: [Port; 3] = [Port::Holder, Port::Wheel, Port::Shutter];
const HOLDER: [HolderKind; 9] = [
    HolderKind::Busy,
    HolderKind::WrongId,
    HolderKind::WrongChecksum,
    HolderKind::Alert,
    HolderKind::Stall,
    HolderKind::Pushed,
    HolderKind::Knob,
    HolderKind::DriveOff,
    HolderKind::NeverArrives,
];
const WHEEL: [WheelKind; 4] = [WheelKind::Stuck, WheelKind::OffByOne, WheelKind::EarlyDone, WheelKind::PlaceUntold];
const SHUTTER: [ShutterKind; 7] = [
    ShutterKind::Stuck,
    ShutterKind::Key,
    ShutterKind::Mode,
    ShutterKind::Interlock,
    ShutterKind::EchoLost,
    ShutterKind::PromptLost,
    ShutterKind::Swallowed,
];
const CAMERA: [CameraKind; 11] = [
    CameraKind::NoFrame,
    CameraKind::Late,
    CameraKind::Stale,
    CameraKind::Repeated,
    CameraKind::Black,
    CameraKind::Truncated,
    CameraKind::SkippedId,
    CameraKind::Hang,
    CameraKind::Lost,
    CameraKind::Forgets,
    CameraKind::NotTaken,
];
const MONITOR: [MonitorKind; 4] =
    [MonitorKind::Hold, MonitorKind::Wavelength, MonitorKind::Units, MonitorKind::Swallowed];
const LAMP: [LampKind; 4] = [LampKind::Off, LampKind::Jump, LampKind::Drift, LampKind::Flicker];
/// What people do that a run survives without another one.
const OPERATOR: [OperatorKind; 3] = [OperatorKind::Pause, OperatorKind::PauseNow, OperatorKind::Flurry];
/// What only happens where somebody goes on with the run, or stands beside it.
const AROUND: [Kind; 13] = [
    Kind::Operator(OperatorKind::Stop),
    Kind::Operator(OperatorKind::Abort),
    Kind::Operator(OperatorKind::Safe),
    Kind::Operator(OperatorKind::SecondDaemon),
    Kind::Operator(OperatorKind::Edit),
    Kind::Disk(DiskKind::Slow),
    Kind::Disk(DiskKind::Full),
    Kind::Disk(DiskKind::Fails),
    Kind::Disk(DiskKind::SyncFails),
    Kind::Process(ProcessKind::Killed),
    Kind::Process(ProcessKind::Panics),
    Kind::Process(ProcessKind::ClockBack),
    Kind::Process(ProcessKind::ClockForward),
];

// === impl Kind ===

impl Kind {
    /// Every kind that a bench by itself can show, in the order of the devices.
    pub fn all() -> Vec<Kind> {
        let lines = PORTS.iter().flat_map(|port| LINE.iter().map(|line| Kind::Line(*port, *line)));
        lines
            .chain(HOLDER.map(Kind::Holder))
            .chain(WHEEL.map(Kind::Wheel))
            .chain(SHUTTER.map(Kind::Shutter))
            .chain(CAMERA.map(Kind::Camera))
            .chain(OPERATOR.map(Kind::Operator))
            .chain(PORTS.map(Kind::LongUnplugged))
            .collect()
    }

    /// Every kind that passes by itself within the patience of a night: nothing may be missing afterwards.
    pub fn transient() -> Vec<Kind> {
        Kind::all().into_iter().filter(|kind| kind.is_transient()).collect()
    }

    /// Every kind that outlasts a night's patience, or is an alarm: somebody goes on with the run.
    pub fn lasting() -> Vec<Kind> {
        Kind::all().into_iter().filter(|kind| !kind.is_transient()).collect()
    }

    /// Every kind of lamp and light monitor, for a bench that has one; all pass by themselves.
    pub fn of_the_light() -> Vec<Kind> {
        let lines = LINE.iter().map(|line| Kind::Line(Port::LightMonitor, *line));
        LAMP.map(Kind::Lamp).into_iter().chain(MONITOR.map(Kind::Monitor)).chain(lines).collect()
    }

    /// Every kind of what is around the bench: disk, process, people. Several end the run, which is gone on with.
    pub fn around() -> Vec<Kind> {
        AROUND.to_vec()
    }

    /// True when it passes by itself.
    pub fn is_transient(self) -> bool {
        // An open door is an alarm: the night ends safely, by policy, and is gone on with when somebody has looked.
        !matches!(self, Kind::LongUnplugged(_) | Kind::Shutter(ShutterKind::Interlock))
    }
}

impl fmt::Display for Kind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Kind::Line(port, kind) => write!(f, "{} line: {}", words(port), words(kind)),
            Kind::Holder(kind) => write!(f, "holder: {}", words(kind)),
            Kind::Wheel(kind) => write!(f, "wheel: {}", words(kind)),
            Kind::Shutter(kind) => write!(f, "shutter: {}", words(kind)),
            Kind::Camera(kind) => write!(f, "camera: {}", words(kind)),
            Kind::Monitor(kind) => write!(f, "light monitor: {}", words(kind)),
            Kind::Lamp(kind) => write!(f, "lamp: {}", words(kind)),
            Kind::Operator(kind) => write!(f, "operator: {}", words(kind)),
            Kind::Disk(kind) => write!(f, "disk: {}", words(kind)),
            Kind::Process(kind) => write!(f, "process: {}", words(kind)),
            Kind::LongUnplugged(port) => write!(f, "{} line: unplugged for long", words(port)),
        }
    }
}

/// `RestartOnCommand` as `restart on command`.
fn words(name: &impl fmt::Debug) -> String {
    let mut text = String::new();
    for c in format!("{name:?}").chars() {
        if c.is_uppercase() && !text.is_empty() {
            text.push(' ');
        }
        text.extend(c.to_lowercase());
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    #[test]
    fn every_kind_has_a_name_of_its_own() {
        let kinds = || [Kind::all(), Kind::of_the_light(), Kind::around()].concat();
        let names: BTreeSet<String> = kinds().iter().map(ToString::to_string).collect();
        assert_eq!(names.len(), kinds().len());
        assert!(names.contains("holder line: restart on command"), "{names:?}");
        assert!(names.contains("light monitor line: stuck"), "{names:?}");
        assert!(Kind::transient().len() < Kind::all().len());
    }
}
