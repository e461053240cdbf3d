//! Twins with their handles: how each sort is disturbed and restarted, and what is true of it.

use super::line::on_usb;
use super::stand::Handles;
use crate::firmware::WireFault;
use crate::firmware::cm110::{Cm110Twin, MonochromatorFault};
use crate::firmware::esp301::Esp301Fault;
use crate::firmware::fw212c::WheelFault;
use crate::firmware::ifw::IfwFault;
use crate::firmware::models::{HolderTwin, ShutterTwin, WheelTwin};
use crate::firmware::newport_1830c::{MonitorFault, Newport1830cTwin};
use crate::firmware::open_shutter::OpenShutterFault;
use crate::firmware::sc10::ShutterFault;
use crate::firmware::smc100::Smc100Fault;
use crate::firmware::usb::oceanoptics::{OceanFault, OceanTwin};
use crate::firmware::usb::pm100::{Pm100Fault, Pm100Twin};
use crate::firmware::zaber::ZaberFault;
use goniod_drivers::conformance::Value;
use goniod_drivers::contract::{ShutterState, Spectrum};
use tokio::time::Instant;

/// How far what a driver says may be from the truth: an axis's tolerance and one count of its encoder, half an angstrom of
/// the monochromator's counter, the noise of the meter's converter (relative), and the last digit of its wavelength.
const OFF_DEG: f64 = 0.011;
const OFF_NM: f64 = 0.06;
const OFF_POWER: f64 = 2e-3;
const OFF_SET_NM: f64 = 0.11;
/// Pixels of a USB2000 that see light, and dark ones.
const ACTIVE: std::ops::Range<usize> = 26..2048;
const DARK: std::ops::Range<usize> = 2..24;
/// Largest relative change by the non-linearity correction of the twin's memory.
const LINEARITY: f64 = 0.021;

/// What is said against what is true.
type Judged = Result<(), String>;

/// Handles of a sample holder; number 1 of the chain is judged.
pub fn holder() -> Handles<HolderTwin> {
    Handles {
        restart: |twin, now| match twin {
            HolderTwin::Zaber(twin) => twin.inject(ZaberFault::Restart(1), now),
            HolderTwin::Esp301(twin) => twin.inject(Esp301Fault::Restart, now),
            HolderTwin::Smc100(twin) => twin.inject(Smc100Fault::Restart(1), now),
        },
        disturb: Some(|twin, fault, now| match twin {
            HolderTwin::Zaber(twin) => twin.inject(ZaberFault::Wire(fault), now),
            HolderTwin::Esp301(twin) => twin.inject(Esp301Fault::Wire(fault), now),
            HolderTwin::Smc100(twin) => twin.inject(Smc100Fault::Wire(fault), now),
        }),
        disturbed: HolderTwin::faults_wait,
        judge: |twin, said, [from, to]| {
            let Value::Angle(said) = said else { return Err("is no angle".into()) };
            let truth = |at| twin.angle_deg(1, at).unwrap_or(f64::NAN);
            within(said.0, [truth(from), truth(to)], OFF_DEG, "degrees")
        },
    }
}

/// Handles of a filter wheel.
pub fn wheel() -> Handles<WheelTwin> {
    Handles {
        restart: |twin, now| match twin {
            WheelTwin::Fw212c(twin) => twin.inject(WheelFault::Restart, now),
            WheelTwin::Ifw(twin) => twin.inject(IfwFault::Restart, now),
        },
        disturb: Some(|twin, fault, now| match twin {
            WheelTwin::Fw212c(twin) => twin.inject(WheelFault::Wire(fault), now),
            WheelTwin::Ifw(twin) => twin.inject(IfwFault::Wire(fault), now),
        }),
        disturbed: WheelTwin::faults_wait,
        judge: |twin, said, span| {
            let Value::Place(said) = said else { return Err("is no place".into()) };
            if span.iter().any(|at| twin.place(*at) == Some(said.0)) {
                return Ok(());
            }
            Err(twin.place(span[1]).map_or_else(|| "it turns".into(), |place| format!("slot {place} is in the beam")))
        },
    }
}

/// Handles of a shutter; one without feedback gives no answer to disturb.
pub fn shutter(feedback: bool) -> Handles<ShutterTwin> {
    Handles {
        restart: |twin, now| match twin {
            ShutterTwin::Sc10(twin) => twin.inject(ShutterFault::Restart, now),
            ShutterTwin::OpenLoop(twin) => twin.inject(OpenShutterFault::Restart, now),
        },
        disturb: if feedback { Some(disturb_sc10) } else { None },
        disturbed: ShutterTwin::faults_wait,
        judge: |twin, said, span| {
            let Value::Blade(said) = said else { return Err("is no state of a shutter".into()) };
            if span.iter().any(|at| twin.light_passes(*at) == (*said == ShutterState::Open)) {
                return Ok(());
            }
            Err(if twin.light_passes(span[1]) { "light passes".into() } else { "no light passes".into() })
        },
    }
}

fn disturb_sc10(twin: &mut ShutterTwin, fault: WireFault, now: Instant) {
    if let ShutterTwin::Sc10(twin) = twin {
        twin.inject(ShutterFault::Wire(fault), now);
    }
}

/// Handles of a monochromator.
pub fn monochromator() -> Handles<Cm110Twin> {
    Handles {
        restart: |twin, now| twin.inject(MonochromatorFault::Restart, now),
        disturb: Some(|twin, fault, now| twin.inject(MonochromatorFault::Wire(fault), now)),
        disturbed: Cm110Twin::faults_wait,
        judge: |twin, said, span| {
            let Value::Wavelength(said) = said else { return Err("is no wavelength".into()) };
            within(said.0, span.map(|at| twin.wavelength_nm(at)), OFF_NM, "nm")
        },
    }
}

/// Handles of a serial light monitor.
pub fn light_monitor() -> Handles<Newport1830cTwin> {
    Handles {
        restart: |twin, now| twin.inject(MonitorFault::Restart, now),
        disturb: Some(|twin, fault, now| twin.inject(MonitorFault::Wire(fault), now)),
        disturbed: Newport1830cTwin::faults_wait,
        judge: |twin, said, span| {
            let set = twin.wavelength_nm();
            match said {
                Value::Wavelength(said) => within(said.0, [set; 2], OFF_SET_NM, "nm"),
                Value::Light(said) => {
                    within(said.wavelength.0, [set; 2], OFF_SET_NM, "nm")?;
                    let truth = span.map(|at| twin.power_w(at));
                    within(said.power_w, truth, OFF_POWER * truth[1].abs(), "W")
                }
                _ => Err("is no reading".into()),
            }
        },
    }
}

/// Handles of a USB light monitor.
pub fn usb_light_monitor() -> Handles<Pm100Twin> {
    Handles {
        restart: |twin, _| twin.inject(Pm100Fault::Restart),
        disturb: Some(|twin, fault, _| twin.inject(Pm100Fault::Wire(on_usb(fault)))),
        disturbed: Pm100Twin::faults_wait,
        judge: |twin, said, _| match said {
            Value::Wavelength(said) => within(said.0, [twin.wavelength(); 2], OFF_SET_NM, "nm"),
            Value::Light(said) => {
                within(said.wavelength.0, [twin.wavelength(); 2], OFF_SET_NM, "nm")?;
                match twin.history().next_back() {
                    Some(power) => within(said.power_w, [power; 2], 0.0, "W"),
                    None => Err("nothing was measured".into()),
                }
            }
            _ => Err("is no reading".into()),
        },
    }
}

/// Handles of a USB2000.
pub fn spectrometer() -> Handles<OceanTwin> {
    Handles {
        restart: |twin, now| twin.inject(OceanFault::Restart, now),
        disturb: Some(|twin, fault: WireFault, now| {
            twin.inject(OceanFault::Query(on_usb(fault.clone())), now);
            twin.inject(OceanFault::Spectrum(on_usb(fault)), now);
        }),
        disturbed: OceanTwin::faults_wait,
        judge: |twin, said, [since, _]| match said {
            Value::Exposure(said) if said.0 == twin.time_us() => Ok(()),
            Value::Exposure(_) => Err(format!("{} us are set", twin.time_us())),
            Value::Spectrum(said) => spectrum(twin, said, since),
            _ => Err("is no spectrum".into()),
        },
    }
}

/// A spectrum is one that the device took, with the time that it says, and that began after `since`. The dark level is a
/// shift and the correction is monotonic, so the pixels' differences tell the period.
fn spectrum(twin: &OceanTwin, said: &Spectrum, since: Instant) -> Judged {
    let same = twin.exposures().rev().find(|exposure| {
        let (Some(active), Some(dark)) = (exposure.raw.get(ACTIVE), exposure.raw.get(DARK)) else { return false };
        let level = dark.iter().map(|&c| f64::from(c)).sum::<f64>() / dark.len() as f64;
        active.len() == said.counts.len()
            && active.iter().zip(&said.counts).all(|(&raw, count)| {
                let v = f64::from(raw) - level;
                (count - v).abs() <= LINEARITY * v.abs() + 1e-6
            })
    });
    match same {
        None => Err("it is none that the device took".into()),
        Some(exposure) if exposure.began < since => Err("it began before it was asked for".into()),
        Some(exposure) if exposure.ended - exposure.began != said.exposure.duration() => {
            Err(format!("it was integrated over {:?}", exposure.ended - exposure.began))
        }
        Some(_) => Ok(()),
    }
}

/// A number lies between two truths, or as near.
fn within(said: f64, truth: [f64; 2], off: f64, unit: &str) -> Judged {
    let (low, high) = (truth[0].min(truth[1]), truth[0].max(truth[1]));
    if said >= low - off && said <= high + off { Ok(()) } else { Err(format!("{} {unit} are true", truth[1])) }
}
