//! What may be asked of each part of a served bench: the words of the models that stand there.

use super::words::{self, CameraDeed, Make, Unplugged, Words};
use crate::firmware::models::{HolderTwin, ShutterTwin, WheelTwin};
use crate::firmware::usb::oceanoptics::OceanFault;
use crate::firmware::usb::pm100::Pm100Fault;
use crate::firmware::{WireFault, cm110, esp301, fw212c, ifw, newport_1830c, sc10, smc100, zaber};
use crate::twins::{Fault, Twins};
use std::time::Duration;

/// What is done to the bench.
#[derive(Debug, Clone, PartialEq)]
pub enum Act {
    /// To a serial device or the lamp.
    Bench(Fault),
    /// To a power meter on USB.
    Meter(Pm100Fault),
    /// To a spectrometer.
    Spectrometer(OceanFault),
    /// A USB device (its bus id) is pulled out for so long.
    UsbUnplugged(&'static str, Duration),
    /// To a camera.
    Camera(String, CameraDeed),
}

/// Acts with their times from now, or the sentence why not.
pub type Acts = Result<Vec<(Duration, Act)>, String>;

/// A word that a part knows.
pub struct Choice {
    /// The word.
    pub word: &'static str,
    /// What its number is.
    pub value: Option<String>,
    /// The acts for a number.
    pub acts: Box<dyn Fn(Option<f64>) -> Acts>,
}

/// Choices of a table of words.
pub fn offer<F: 'static>(
    table: &'static Words<F>,
    stage: u8,
    wrap: impl Fn(F) -> Act + Clone + 'static,
) -> Vec<Choice> {
    let choice = |(word, make): &'static (&'static str, Make<F>)| {
        let wrap = wrap.clone();
        let acts = move |value: Option<f64>| -> Acts {
            Ok(make.faults(stage, value)?.into_iter().map(|(at, fault)| (at, wrap(fault))).collect())
        };
        Choice { word, value: make.value(), acts: Box::new(acts) }
    };
    table.iter().map(choice).collect()
}

/// Choices of a model on a serial line: its own, those of the wire, those of the adapter.
fn model<F: 'static>(
    table: &'static Words<F>,
    stage: u8,
    port: &'static str,
    wire: Option<fn(WireFault) -> F>,
    wrap: impl Fn(F) -> Act + Clone + 'static,
) -> Vec<Choice> {
    let mut all = offer(table, stage, wrap.clone());
    if let Some(wire) = wire {
        all.extend(offer(words::WIRE, stage, move |fault| wrap(wire(fault))));
    }
    all.extend(offer(words::PLUG, stage, |Unplugged(time)| Act::Bench(Fault::Unplugged(port.to_owned(), time))));
    all
}

/// What may be asked of the holder; `stage` 1 tilts, 2 spins, 3 changes the sample.
pub fn holder(twins: &Twins, stage: u8) -> Vec<Choice> {
    let port = "sim:holder";
    twins.holder.peek(|twin| match twin {
        HolderTwin::Zaber(_) => {
            model(words::ZABER, stage, port, Some(zaber::ZaberFault::Wire), |f| Act::Bench(Fault::Holder(f)))
        }
        HolderTwin::Esp301(_) => {
            model(words::ESP301, stage, port, Some(esp301::Esp301Fault::Wire), |f| Act::Bench(Fault::Esp301(f)))
        }
        HolderTwin::Smc100(_) => {
            model(words::SMC100, stage, port, Some(smc100::Smc100Fault::Wire), |f| Act::Bench(Fault::Smc100(f)))
        }
    })
}

/// What may be asked of the filter wheel.
pub fn wheel(twins: &Twins) -> Vec<Choice> {
    let port = "sim:filter-wheel";
    twins.wheel.peek(|twin| match twin {
        WheelTwin::Fw212c(_) => {
            model(words::FW212C, 1, port, Some(fw212c::WheelFault::Wire), |f| Act::Bench(Fault::Wheel(f)))
        }
        WheelTwin::Ifw(_) => model(words::IFW, 1, port, Some(ifw::IfwFault::Wire), |f| Act::Bench(Fault::Ifw(f))),
    })
}

/// What may be asked of the shutter.
pub fn shutter(twins: &Twins) -> Vec<Choice> {
    let port = "sim:shutter";
    twins.shutter.peek(|twin| match twin {
        ShutterTwin::Sc10(_) => {
            model(words::SC10, 1, port, Some(sc10::ShutterFault::Wire), |f| Act::Bench(Fault::Shutter(f)))
        }
        // Nothing is ever answered, so no answer can go wrong.
        ShutterTwin::OpenLoop(_) => model(words::OPEN_SHUTTER, 1, port, None, |f| Act::Bench(Fault::OpenShutter(f))),
    })
}

/// What may be asked of the monochromator.
pub fn monochromator() -> Vec<Choice> {
    let wire = cm110::MonochromatorFault::Wire;
    model(words::CM110, 1, "sim:monochromator", Some(wire), |f| Act::Bench(Fault::Monochromator(f)))
}

/// What may be asked of the light monitor on a serial line.
pub fn light_monitor() -> Vec<Choice> {
    let wire = newport_1830c::MonitorFault::Wire;
    model(words::NEWPORT_1830C, 1, "sim:light-monitor", Some(wire), |f| Act::Bench(Fault::LightMonitor(f)))
}

/// What may be asked of a power meter on USB at `busid`.
pub fn meter(busid: &'static str) -> Vec<Choice> {
    let mut all = offer(words::PM100, 1, Act::Meter);
    all.extend(offer(words::USB, 1, |f| Act::Meter(Pm100Fault::Wire(f))));
    all.extend(offer(words::PLUG, 1, move |Unplugged(time)| Act::UsbUnplugged(busid, time)));
    all
}

/// What may be asked of a spectrometer at `busid`.
pub fn spectrometer(busid: &'static str) -> Vec<Choice> {
    let mut all = offer(words::OCEAN, 1, Act::Spectrometer);
    all.extend(offer(words::USB, 1, |f| Act::Spectrometer(OceanFault::Spectrum(f))));
    all.extend(offer(words::PLUG, 1, move |Unplugged(time)| Act::UsbUnplugged(busid, time)));
    all
}

/// What may be asked of the lamp.
pub fn lamp() -> Vec<Choice> {
    offer(words::LAMP, 1, |f| Act::Bench(Fault::Lamp(f)))
}

/// What may be asked of a camera.
pub fn camera(name: &str) -> Vec<Choice> {
    let name = name.to_owned();
    offer(words::CAMERA, 1, move |deed| Act::Camera(name.clone(), deed))
}
