//! Every kind of fault a fault plan may hold, over all devices of the bench.
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
    /// The operator pauses for some minutes.
    Pause,
    /// An adapter stays away for many minutes.
    LongUnplugged(Port),
}

const LINE: [LineKind; 11] = [
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
];
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
const CAMERA: [CameraKind; 10] = [
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
];

// === impl Kind ===

impl Kind {
    /// Every kind.
    pub fn all() -> Vec<Kind> {
        let lines = PORTS.iter().flat_map(|port| LINE.iter().map(|line| Kind::Line(*port, *line)));
        lines
            .chain(HOLDER.map(Kind::Holder))
            .chain(WHEEL.map(Kind::Wheel))
            .chain(SHUTTER.map(Kind::Shutter))
            .chain(CAMERA.map(Kind::Camera))
            .chain([Kind::Pause])
            .chain(PORTS.map(Kind::LongUnplugged))
            .collect()
    }

    /// Every kind that passes by itself within the patience of a night: nothing may be missing afterwards.
    pub fn transient() -> Vec<Kind> {
        Kind::all().into_iter().filter(|kind| kind.is_transient()).collect()
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
            Kind::Pause => write!(f, "operator: pause"),
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
        let names: BTreeSet<String> = Kind::all().iter().map(ToString::to_string).collect();
        assert_eq!(names.len(), Kind::all().len());
        assert!(names.contains("holder line: restart on command"), "{names:?}");
        assert!(Kind::transient().len() < Kind::all().len());
    }
}
