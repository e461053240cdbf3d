//! The switchboard of a served bench: one line of text lets a fault happen, or asks what is true.

use super::choice::{self, Act, Choice};
use super::usb::UsbDevices;
use super::words::CameraDeed;
use crate::gige::GigeTwin;
use crate::pose::PoseSource;
use crate::truth::lamp::SimLamp;
use crate::twins::Twins;
use goniod_drivers::clock::Clock;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Words that ask and change nothing.
const ASKING: [&str; 3] = ["pose", "faults", "counters"];

/// A camera that another task may switch off.
pub type SharedCamera = Arc<Mutex<GigeTwin>>;

/// Everything faults can happen to.
pub struct Board {
    /// Serial devices.
    pub twins: Twins,
    /// The lamp that all look at.
    pub lamp: SimLamp,
    /// Serial parts that stand on this bench beside holder, wheel and shutter.
    pub monochromator: bool,
    /// A light monitor on a serial line.
    pub light_monitor: bool,
    /// Cameras by name.
    pub cameras: BTreeMap<String, SharedCamera>,
    /// USB devices.
    pub usb: UsbDevices,
    /// Time.
    pub clock: Clock,
    /// How often each fault was asked for.
    pub asked: Mutex<BTreeMap<String, u64>>,
}

/// The value behind a mutex, whatever happened to another holder.
pub(super) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

// === impl Board ===

impl Board {
    /// Carries one line out: `PART FAULT [NUMBER]`, `pose`, `faults` or `counters`.
    ///
    /// # Errors
    /// One sentence: what is wrong and what may be written. Nothing happened then.
    pub fn carry_out(self: &Arc<Board>, line: &str) -> Result<Value, String> {
        let words: Vec<&str> = line.split_whitespace().collect();
        match words.as_slice() {
            [] => Err(format!("the line is empty; write `PART FAULT [NUMBER]` or {}", quoted(ASKING))),
            ["pose"] => Ok(self.pose()),
            ["faults"] => Ok(self.list()),
            ["counters"] => Ok(self.counters()),
            [asking, ..] if ASKING.contains(asking) => Err(format!("`{asking}` stands alone; leave the rest out")),
            [part] => {
                let choices = self.of(part)?;
                Err(format!("`{part}` needs a fault: {}", quoted(choices.iter().map(|c| c.word))))
            }
            [part, word] => self.fault(part, word, None),
            [part, word, number] => {
                let value = number.parse::<f64>().ok().filter(|v| v.is_finite());
                let value = value.ok_or_else(|| format!("`{number}` is not a number; write it like 3 or 0.5"))?;
                self.fault(part, word, Some(value))
            }
            _ => Err(format!("`{line}` has too many words; write `PART FAULT [NUMBER]`")),
        }
    }

    /// Names of the parts.
    pub fn parts(&self) -> Vec<String> {
        let mut parts: Vec<String> =
            ["holder", "tilt", "spin", "changer", "filter_wheel", "shutter", "lamp"].map(str::to_owned).into();
        let lit = self.light_monitor || self.usb.meter.is_some();
        let more = [
            ("light_monitor", lit),
            ("monochromator", self.monochromator),
            ("spectrometer", self.usb.spectrometer.is_some()),
        ];
        parts.extend(more.iter().filter(|(_, there)| *there).map(|(name, _)| (*name).to_owned()));
        parts.extend(self.cameras.keys().cloned());
        parts
    }

    /// What may be asked of a part.
    fn of(&self, part: &str) -> Result<Vec<Choice>, String> {
        let plain = part.replace('-', "_");
        let plain = plain.strip_prefix("camera.").unwrap_or(&plain);
        let twins = &self.twins;
        Ok(match plain {
            "holder" | "tilt" => choice::holder(twins, 1),
            "spin" => choice::holder(twins, 2),
            "changer" => choice::holder(twins, 3),
            "filter_wheel" | "wheel" => choice::wheel(twins),
            "shutter" => choice::shutter(twins),
            "lamp" => choice::lamp(),
            "monochromator" if self.monochromator => choice::monochromator(),
            "light_monitor" if self.light_monitor => choice::light_monitor(),
            "light_monitor" if self.usb.meter.is_some() => choice::meter(UsbDevices::METER),
            "spectrometer" if self.usb.spectrometer.is_some() => choice::spectrometer(UsbDevices::SPECTROMETER),
            camera if self.cameras.contains_key(camera) => choice::camera(camera),
            _ => return Err(format!("the bench has no `{part}`; it has {}", quoted(self.parts()))),
        })
    }

    fn fault(self: &Arc<Board>, part: &str, word: &str, value: Option<f64>) -> Result<Value, String> {
        let choices = self.of(part)?;
        let plain = word.replace('_', "-");
        let choice = choices.iter().find(|c| c.word == plain).ok_or_else(|| {
            format!("`{part}` has no fault `{word}`; it has {}", quoted(choices.iter().map(|c| c.word)))
        })?;
        let acts = (choice.acts)(value).map_err(|why| format!("`{part} {word}`: {why}"))?;
        *lock(&self.asked).entry(format!("{part} {}", choice.word)).or_default() += 1;
        let mut later = Vec::new();
        for (after, act) in acts {
            if after.is_zero() { self.act(act) } else { later.push((after, act)) }
        }
        for (after, act) in later {
            let board = Arc::clone(self);
            tokio::spawn(async move {
                board.clock.sleep(after).await;
                board.act(act);
            });
        }
        let seconds = value.map_or(Value::Null, |v| json!(v));
        Ok(json!({ "done": format!("{part} {}", choice.word), "number": seconds }))
    }

    fn act(self: &Arc<Board>, act: Act) {
        match act {
            Act::Bench(fault) => self.twins.inject(fault),
            Act::Meter(fault) => {
                self.usb.meter.iter().for_each(|twin| lock(twin).inject(fault.clone()));
            }
            Act::Spectrometer(fault) => {
                self.usb.spectrometer.iter().for_each(|twin| lock(twin).inject(fault.clone(), self.clock.now()));
            }
            Act::UsbUnplugged(busid, time) => {
                self.usb.unplug(busid);
                let board = Arc::clone(self);
                tokio::spawn(async move {
                    board.clock.sleep(time).await;
                    // Waits for the kernel.
                    tokio::task::spawn_blocking(move || board.usb.plug(busid));
                });
            }
            Act::Camera(name, deed) => {
                let Some(camera) = self.cameras.get(&name).map(Arc::clone) else { return };
                // Switching off waits for the camera's threads.
                tokio::task::spawn_blocking(move || camera_deed(&mut lock(&camera), deed));
            }
        }
    }

    fn pose(&self) -> Value {
        let now = self.clock.now();
        let pose = self.twins.pose(now);
        json!({
            "tilt_deg": pose.tilt_deg,
            "spin_deg": pose.spin_deg,
            "changer_deg": pose.changer_deg,
            "slot": pose.slot,
            "shutter_open": pose.shutter_open,
            "lamp_burns": self.lamp.burns(now),
            "lamp_factor": self.lamp.factor(now),
        })
    }

    fn list(&self) -> Value {
        let parts = self.parts().into_iter().map(|part| {
            let words: serde_json::Map<String, Value> = match self.of(&part) {
                Ok(choices) => choices.into_iter().map(|c| (c.word.to_owned(), json!(c.value))).collect(),
                Err(_) => serde_json::Map::new(),
            };
            (part, Value::Object(words))
        });
        Value::Object(parts.collect())
    }

    fn counters(&self) -> Value {
        let twins = &self.twins;
        let waiting = [
            ("holder", twins.holder.peek(|t| t.faults_wait())),
            ("filter_wheel", twins.wheel.peek(|t| t.faults_wait())),
            ("shutter", twins.shutter.peek(|t| t.faults_wait())),
        ];
        let mut waiting: Vec<String> =
            waiting.into_iter().filter(|(_, waits)| *waits).map(|(name, _)| name.to_owned()).collect();
        let mut cameras = serde_json::Map::new();
        for (name, camera) in &self.cameras {
            let camera = lock(camera);
            camera.faults(|f| {
                if !f.next.is_empty() {
                    waiting.push(name.clone())
                }
            });
            let traffic = camera.traffic();
            let faulty = camera.truth().iter().filter(|t| t.fault.is_some()).count();
            let counts = json!({
                "blocks": traffic.blocks,
                "packets": traffic.packets,
                "dropped": traffic.dropped,
                "resent": traffic.resent,
                "refused": traffic.refused,
                "heartbeats_missed": traffic.heartbeats_missed,
                "triggers_ignored": traffic.triggers_ignored,
                "frames_with_fault": faulty,
            });
            cameras.insert(name.clone(), counts);
        }
        json!({ "asked": *lock(&self.asked), "waiting": waiting, "cameras": cameras, "usb": self.usb.counters() })
    }
}

fn camera_deed(camera: &mut GigeTwin, deed: CameraDeed) {
    match deed {
        CameraDeed::Next(fault) => camera.faults(|f| f.next.push_back(fault)),
        CameraDeed::Freeze(on) => camera.freeze(on),
        CameraDeed::PowerCut(true) => camera.kill(),
        CameraDeed::PowerCut(false) => {
            if let Err(error) = camera.power_up() {
                tracing::error!(address = camera.address(), %error, "the simulated camera cannot be switched on again");
            }
        }
        CameraDeed::DropControl => camera.drop_control(),
        CameraDeed::Deaf(on) => camera.faults(|f| f.deaf = on),
        CameraDeed::Mute(on) => camera.faults(|f| f.mute = on),
        CameraDeed::PacketLoss(per_1000) => camera.faults(|f| f.drop_per_1000 = per_1000),
        CameraDeed::Readback(factor) => camera.faults(|f| f.wrong_readback = (factor != 1.0).then_some(factor)),
    }
}

/// Names for a sentence.
fn quoted(names: impl IntoIterator<Item = impl AsRef<str>>) -> String {
    names.into_iter().map(|name| format!("`{}`", name.as_ref())).collect::<Vec<_>>().join(", ")
}
