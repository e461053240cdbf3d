//! Faults in words: what each model can be made to do wrong, by a word and one number where there is one.
//!
//! The words are those of the [catalogue](crate::faults); what only one model can do has words of its own.

use crate::firmware::WireFault;
use crate::firmware::cm110::MonochromatorFault;
use crate::firmware::esp301::Esp301Fault;
use crate::firmware::fw212c::WheelFault;
use crate::firmware::ifw::IfwFault;
use crate::firmware::newport_1830c::MonitorFault;
use crate::firmware::open_shutter::OpenShutterFault;
use crate::firmware::sc10::ShutterFault;
use crate::firmware::smc100::Smc100Fault;
use crate::firmware::usb::UsbFault;
use crate::firmware::usb::oceanoptics::OceanFault;
use crate::firmware::usb::pm100::Pm100Fault;
use crate::firmware::zaber::ZaberFault;
use crate::gige::FrameFault;
use crate::truth::lamp::LampFault;
use std::time::Duration;

/// How a fault is made from a stage number (1 tilt, 2 spin, 3 changer; 1 where there are no stages) and a value.
pub enum Make<F: 'static> {
    /// Once, without a value.
    Plain(fn(u8) -> F),
    /// Several that make one.
    Together(fn() -> Vec<F>),
    /// As many times as the value says, once where it says nothing.
    Times(fn() -> F),
    /// With a value: what it is, and what it is where none is said (`None`: it must be said).
    With(&'static str, Option<f64>, fn(u8, f64) -> F),
    /// On now, off after as many seconds as the value says, else these.
    For(f64, fn(u8, bool) -> F),
}

/// Words of a model.
pub type Words<F> = [(&'static str, Make<F>)];

/// What can be done to a camera.
#[derive(Debug, Clone, PartialEq)]
pub enum CameraDeed {
    /// A fault of the next frame.
    Next(FrameFault),
    /// It hangs (true) or thaws.
    Freeze(bool),
    /// Its power fails (true), or comes back with the settings of the factory.
    PowerCut(bool),
    /// Another takes control away.
    DropControl,
    /// It answers nothing (true), or again.
    Deaf(bool),
    /// It sends nothing (true), or again.
    Mute(bool),
    /// Stream packets lost of 1,000, from now on.
    PacketLoss(u32),
    /// The integration time reads back as this multiple, from now on.
    Readback(f64),
}

/// What can be done to an adapter: pulled out for so long.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Unplugged(pub Duration);

/// Most times that one line may ask for.
const MOST_TIMES: f64 = 1000.0;
/// Longest time that one line may ask for, seconds.
const LONGEST_S: f64 = 86_400.0;
/// Values beyond are slips.
const LARGEST: f64 = 1e5;

/// Of any answer on a serial line.
pub const WIRE: &Words<WireFault> = &[
    ("garbage", Make::With("bytes", Some(5.0), |_, n| WireFault::Junk(junk(n)))),
    ("changed-byte", Make::With("place", Some(2.0), |_, place| WireFault::Corrupt(place as usize, 0x15))),
    ("lost-byte", Make::With("place", Some(2.0), |_, place| WireFault::Drop(place as usize))),
    ("cut", Make::With("bytes that come", Some(3.0), |_, keep| WireFault::Cut(keep as usize))),
    ("doubled", Make::Times(|| WireFault::Duplicate)),
    ("late", Make::With("seconds", Some(2.0), |_, s| WireFault::Late(seconds(s)))),
    ("previous", Make::Times(|| WireFault::Previous)),
    ("silence", Make::Times(|| WireFault::NoReply)),
];

/// Of any answer on USB.
pub const USB: &Words<UsbFault> = &[
    ("garbage", Make::With("bytes", Some(5.0), |_, n| UsbFault::Junk(junk(n)))),
    ("changed-byte", Make::With("place", Some(2.0), |_, place| UsbFault::Corrupt(place as usize, 0x15))),
    ("cut", Make::With("bytes that come", Some(3.0), |_, keep| UsbFault::Cut(keep as usize))),
    ("doubled", Make::Times(|| UsbFault::Duplicate)),
    ("late", Make::With("seconds", Some(2.0), |_, s| UsbFault::Late(seconds(s)))),
    ("previous", Make::Times(|| UsbFault::Previous)),
    ("silence", Make::Times(|| UsbFault::NoReply)),
    ("stall", Make::Times(|| UsbFault::Stall)),
    ("babble", Make::Times(|| UsbFault::Babble)),
    ("restart-on-command", Make::Plain(|_| UsbFault::Restart)),
];

/// Of any adapter.
pub const PLUG: &Words<Unplugged> = &[
    ("unplugged", Make::With("seconds", Some(3.0), |_, s| Unplugged(seconds(s)))),
    ("unplugged-for-long", Make::With("seconds", Some(900.0), |_, s| Unplugged(seconds(s)))),
];

/// Of a Zaber chain.
pub const ZABER: &Words<ZaberFault> = &[
    ("busy", Make::With("requests", Some(1.0), |_, n| ZaberFault::Again(n as u8))),
    ("wrong-id", Make::Times(|| ZaberFault::WrongId)),
    ("wrong-checksum", Make::Times(|| ZaberFault::WrongLrc)),
    ("alert", Make::Times(|| ZaberFault::AlertBetween)),
    ("split", Make::Times(|| ZaberFault::SplitReply)),
    ("stall", Make::With("degrees", None, ZaberFault::Stall)),
    ("pushed", Make::With("degrees", Some(1.0), ZaberFault::Displaced)),
    ("knob", Make::With("degrees", Some(1.0), ZaberFault::Knob)),
    ("drive-off", Make::Plain(ZaberFault::DriverOff)),
    ("never-arrives", Make::Plain(ZaberFault::NeverArrives)),
    ("parked", Make::Plain(ZaberFault::Parked)),
    ("restart", Make::Plain(ZaberFault::Restart)),
    ("restart-on-command", Make::Plain(|_| ZaberFault::RestartOnCommand)),
];

/// Of an ESP300 or ESP301.
pub const ESP301: &Words<Esp301Fault> = &[
    ("lost-cr", Make::Times(|| Esp301Fault::LostCr)),
    ("glued", Make::Times(|| Esp301Fault::Glued)),
    ("unsolicited", Make::Times(|| Esp301Fault::Unsolicited)),
    ("stall", Make::With("degrees", None, Esp301Fault::Jam)),
    ("limit-switch", Make::Plain(|stage| Esp301Fault::LimitSwitch(stage, true))),
    ("drive-off", Make::Plain(Esp301Fault::MotorOff)),
    ("home-glitch", Make::Plain(Esp301Fault::HomeGlitch)),
    ("overshoot", Make::With("degrees", Some(1.0), Esp301Fault::Overshoot)),
    ("never-arrives", Make::Plain(Esp301Fault::NeverDone)),
    ("knob", Make::With("degrees", Some(1.0), Esp301Fault::Hand)),
    ("units", Make::With("number", Some(9.0), |stage, n| Esp301Fault::Units(stage, n as u8))),
    ("stage-unknown", Make::Plain(Esp301Fault::Unknown)),
    ("emergency-stop", Make::For(5.0, |_, on| Esp301Fault::EmergencyStop(on))),
    ("cable-out", Make::For(5.0, |_, on| Esp301Fault::CableInterlock(on))),
    ("restart", Make::Plain(|_| Esp301Fault::Restart)),
    ("restart-on-command", Make::Plain(|_| Esp301Fault::RestartOnCommand)),
];

/// Of SMC100 boxes.
pub const SMC100: &Words<Smc100Fault> = &[
    ("stall", Make::With("degrees", None, Smc100Fault::Jam)),
    ("overshoot", Make::With("degrees", Some(1.0), Smc100Fault::Overshoot)),
    ("never-arrives", Make::Plain(Smc100Fault::NeverDone)),
    ("home-timeout", Make::Plain(Smc100Fault::HomeTimeout)),
    ("drive-off", Make::Plain(Smc100Fault::Disabled)),
    ("knob", Make::With("degrees", Some(1.0), Smc100Fault::Hand)),
    ("restart", Make::Plain(Smc100Fault::Restart)),
    ("restart-on-command", Make::Plain(|_| Smc100Fault::RestartOnCommand)),
];

/// Of a FW212C wheel.
pub const FW212C: &Words<WheelFault> = &[
    ("stuck", Make::For(5.0, |_, on| WheelFault::Jam(on))),
    ("off-by-one", Make::With("places", Some(1.0), |_, n| WheelFault::Button(n as i8))),
    ("early-done", Make::Plain(|_| WheelFault::PromptEarly)),
    // Asked while it turns, which only an early prompt brings about.
    ("place-untold", Make::Together(|| vec![WheelFault::PositionEmpty, WheelFault::PromptEarly])),
    ("lost-count", Make::Plain(|_| WheelFault::LostEdge)),
    ("places", Make::With("places", Some(6.0), |_, n| WheelFault::PlaceCount(n as u8))),
    ("restart", Make::Plain(|_| WheelFault::Restart)),
    ("restart-on-command", Make::Plain(|_| WheelFault::RestartOnCommand)),
];

/// Of an Optec wheel.
pub const IFW: &Words<IfwFault> = &[
    ("stuck", Make::For(5.0, |_, on| IfwFault::Stuck(on))),
    ("off-by-one", Make::With("places", Some(1.0), |_, n| IfwFault::Button(n as u8))),
    ("slips", Make::Plain(|_| IfwFault::Slips)),
    ("lost-count", Make::Plain(|_| IfwFault::OffByOne)),
    ("other-wheel", Make::Plain(|_| IfwFault::Wheel('B'))),
    ("no-line-feed", Make::Times(|| IfwFault::NoLineFeed)),
    ("stray-line-feed", Make::Times(|| IfwFault::StrayLineFeed)),
    ("restart", Make::Plain(|_| IfwFault::Restart)),
    ("restart-on-command", Make::Plain(|_| IfwFault::RestartOnCommand)),
];

/// Of a SC10 shutter.
pub const SC10: &Words<ShutterFault> = &[
    ("stuck", Make::For(5.0, |_, on| ShutterFault::Stuck(on))),
    ("key", Make::Plain(|_| ShutterFault::FrontKey)),
    ("mode", Make::With("number", Some(2.0), |_, n| ShutterFault::Mode(n as u8))),
    ("interlock", Make::For(5.0, |_, on| ShutterFault::Interlock(on))),
    ("echo-lost", Make::Times(|| ShutterFault::EchoLost)),
    ("prompt-lost", Make::Plain(|_| ShutterFault::PromptLostAfterToggle)),
    ("swallowed", Make::Times(|| ShutterFault::FirstSwallowed)),
    ("sensor-dead", Make::For(5.0, |_, on| ShutterFault::SensorDead(on))),
    ("restart", Make::Plain(|_| ShutterFault::Restart)),
    ("restart-on-command", Make::Plain(|_| ShutterFault::RestartOnCommand)),
];

/// Of a shutter without feedback.
pub const OPEN_SHUTTER: &Words<OpenShutterFault> = &[
    ("bytes-lost", Make::With("bytes", Some(1.0), |_, n| OpenShutterFault::BytesLost(n as u32))),
    ("local", Make::For(5.0, |_, on| OpenShutterFault::Local(on))),
    ("stuck", Make::For(5.0, |_, on| OpenShutterFault::Stuck(on))),
    ("hand-opens", Make::Plain(|_| OpenShutterFault::Hand(true))),
    ("hand-closes", Make::Plain(|_| OpenShutterFault::Hand(false))),
    ("restart", Make::Plain(|_| OpenShutterFault::Restart)),
];

/// Of a CM110 monochromator.
pub const CM110: &Words<MonochromatorFault> = &[
    ("no-end", Make::Times(|| MonochromatorFault::NoEnd)),
    ("no-end-after-rejection", Make::Times(|| MonochromatorFault::NoEndAfterRejection)),
    ("units", Make::With("number", Some(0.0), |_, n| MonochromatorFault::Units(n as u8))),
    ("slow", Make::With("factor", Some(3.0), |_, factor| MonochromatorFault::Slow(factor))),
    ("never-arrives", Make::Plain(|_| MonochromatorFault::NeverArrives)),
    ("off", Make::With("angstroms", Some(20.0), |_, by| MonochromatorFault::Off(by as i32))),
    ("knob", Make::With("nanometres", Some(500.0), |_, nm| MonochromatorFault::Turned(nm))),
    ("restart", Make::Plain(|_| MonochromatorFault::Restart)),
    ("restart-in-move", Make::Plain(|_| MonochromatorFault::RestartInMove)),
    ("restart-on-command", Make::Plain(|_| MonochromatorFault::RestartOnCommand)),
];

/// Of a 1830-C power meter.
pub const NEWPORT_1830C: &Words<MonitorFault> = &[
    ("front-wavelength", Make::With("nanometres", Some(633.0), |_, nm| MonitorFault::FrontWavelength(nm as u16))),
    ("hold", Make::Plain(|_| MonitorFault::Hold)),
    ("front-units", Make::With("number", Some(2.0), |_, n| MonitorFault::FrontUnits(n as u8))),
    ("no-head", Make::For(5.0, |_, on| MonitorFault::NoHead(on))),
    ("setting-swallowed", Make::Times(|| MonitorFault::SettingSwallowed)),
    ("restart", Make::Plain(|_| MonitorFault::Restart)),
    ("restart-on-command", Make::Plain(|_| MonitorFault::RestartOnCommand)),
];

/// Of a PM100 power meter.
pub const PM100: &Words<Pm100Fault> = &[
    ("front-wavelength", Make::With("nanometres", Some(633.0), |_, nm| Pm100Fault::WavelengthByHand(nm as u32))),
    ("no-head", Make::Plain(|_| Pm100Fault::Head(None))),
    ("restart", Make::Plain(|_| Pm100Fault::Restart)),
];

/// Of a spectrometer.
pub const OCEAN: &Words<OceanFault> = &[
    ("stale", Make::With("spectra", Some(1.0), |_, n| OceanFault::Stale(n as u32))),
    ("dead", Make::For(5.0, |_, on| OceanFault::Dead(on))),
    ("restart", Make::Plain(|_| OceanFault::Restart)),
];

/// Of the lamp.
pub const LAMP: &Words<LampFault> = &[
    ("off", Make::Plain(|_| LampFault::Off)),
    ("strike", Make::Plain(|_| LampFault::Strike)),
    ("drift", Make::With("part of its light an hour", Some(0.02), |_, part| LampFault::Drift(part))),
    ("jump", Make::With("part of its light", Some(-0.03), |_, part| LampFault::Jump(part))),
    ("flicker", Make::With("standard deviation", Some(0.005), |_, part| LampFault::Flicker(part))),
];

/// Of a GigE Vision camera.
pub const CAMERA: &Words<CameraDeed> = &[
    ("no-frame", Make::Times(|| CameraDeed::Next(FrameFault::NoFrame))),
    ("late", Make::With("seconds", Some(3.0), |_, s| CameraDeed::Next(FrameFault::Late(seconds(s))))),
    ("stale", Make::Times(|| CameraDeed::Next(FrameFault::Stale))),
    ("repeated", Make::Times(|| CameraDeed::Next(FrameFault::Repeated))),
    ("black", Make::Times(|| CameraDeed::Next(FrameFault::Black))),
    ("truncated", Make::Times(|| CameraDeed::Next(FrameFault::Short))),
    ("skipped-id", Make::Times(|| CameraDeed::Next(FrameFault::SkippedId))),
    ("hang", Make::For(6.0, |_, on| CameraDeed::Freeze(on))),
    ("freeze", Make::For(6.0, |_, on| CameraDeed::Freeze(on))),
    ("lost", Make::For(6.0, |_, on| CameraDeed::PowerCut(on))),
    ("forgets", Make::For(0.5, |_, on| CameraDeed::PowerCut(on))),
    ("control-lost", Make::Plain(|_| CameraDeed::DropControl)),
    ("deaf", Make::For(6.0, |_, on| CameraDeed::Deaf(on))),
    ("mute", Make::For(6.0, |_, on| CameraDeed::Mute(on))),
    ("packet-loss", Make::With("of 1000", Some(20.0), |_, n| CameraDeed::PacketLoss(n.clamp(0.0, 1000.0) as u32))),
    ("wrong-readback", Make::With("factor", Some(1.1), |_, factor| CameraDeed::Readback(factor))),
];

fn seconds(s: f64) -> Duration {
    Duration::try_from_secs_f64(s.min(LONGEST_S)).unwrap_or_default()
}

fn junk(count: f64) -> Vec<u8> {
    (0..count.min(LARGEST) as u32).map(|i| (0x2b + 0x35 * i) as u8).collect()
}

// === impl Make ===

impl<F> Make<F> {
    /// What the value is, for the list of words; `None` where there is none.
    pub fn value(&self) -> Option<String> {
        match self {
            Make::Plain(_) | Make::Together(_) => None,
            Make::Times(_) => Some("times, else 1".to_owned()),
            Make::With(what, Some(usual), _) => Some(format!("{what}, else {usual}")),
            Make::With(what, None, _) => Some((*what).to_owned()),
            Make::For(usual, _) => Some(format!("seconds, else {usual}")),
        }
    }

    /// The faults in their order, each with the time from now.
    ///
    /// # Errors
    /// A sentence: a value that is missing, too many or out of range.
    pub fn faults(&self, stage: u8, value: Option<f64>) -> Result<Vec<(Duration, F)>, String> {
        let within = |low: f64, high: f64, usual: f64| match value {
            Some(v) if !(v >= low && v <= high) => {
                Err(format!("{v} is not possible; write a number from {low} to {high}"))
            }
            v => Ok(v.unwrap_or(usual)),
        };
        Ok(match self {
            Make::Plain(_) | Make::Together(_) if value.is_some() => {
                return Err("it takes no number; leave the number out".to_owned());
            }
            Make::Plain(make) => vec![(Duration::ZERO, make(stage))],
            Make::Together(make) => make().into_iter().map(|fault| (Duration::ZERO, fault)).collect(),
            Make::Times(make) => {
                let times = within(1.0, MOST_TIMES, 1.0)? as u32;
                (0..times).map(|_| (Duration::ZERO, make())).collect()
            }
            Make::With(what, None, _) if value.is_none() => return Err(format!("it needs a number: {what}")),
            Make::With(_, usual, make) => {
                vec![(Duration::ZERO, make(stage, within(-LARGEST, LARGEST, usual.unwrap_or_default())?))]
            }
            Make::For(usual, make) => {
                let time = seconds(within(0.0, LONGEST_S, *usual)?);
                vec![(Duration::ZERO, make(stage, true)), (time, make(stage, false))]
            }
        })
    }
}
