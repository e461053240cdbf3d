//! A UVC 1.0 camera in software, as a [`UsbTwin`]: behind the USB/IP front the kernel's own `uvcvideo` drives it.
//!
//! Its picture comes from a [`Scene`] for the settings in force at the start of the exposure; what it really did for
//! every frame is in [`UvcTwin::truth`]. It powers up as cameras for people do: automatic exposure, gain, gamma 2.
//!
//! - [`descriptors`], [`controls`], [`negotiation`]: what it tells and obeys
//! - [`mode`], [`sensor`]: formats, exposures; [`faults`]: what can go wrong, and the record of truth

pub mod controls;
pub mod descriptors;
pub mod faults;
pub mod mode;
pub mod negotiation;
pub mod sensor;
#[cfg(test)]
mod tests;

pub use controls::Settings;
pub use faults::{Faults, FrameFault, Truth};
pub use mode::{Mode, UvcFormat};

use crate::front::usb::{Answer, Descriptors, SetupPacket, UsbTwin};
use crate::gige::faults::Draws;
use crate::scene::Scene;
use controls::Controls;
use descriptors::{CONTROL_INTERFACE, STREAM, STREAM_INTERFACE};
use negotiation::{Agreement, Negotiation, Outcome, PAYLOAD};
use sensor::{Logbook, Outgoing, Sensor};
use std::sync::Arc;
use std::time::Duration;
use tokio::time::Instant;

/// Bytes of a payload header: length and flags.
const HEADER: usize = 2;
/// Toggles with every frame.
const FRAME_ID: u8 = 0x01;
/// The last payload of a frame.
const END_OF_FRAME: u8 = 0x02;
/// Something went wrong in this frame.
const ERROR: u8 = 0x40;
/// The header ends here.
const END_OF_HEADER: u8 = 0x80;

/// How a camera is made.
#[derive(Debug, Clone, PartialEq)]
pub struct UvcConfig {
    /// Serial number.
    pub serial: String,
    /// Formats with their sizes.
    pub modes: Vec<Mode>,
    /// Read-out time of a frame.
    pub readout: Duration,
    /// Seed of the frame faults.
    pub seed: u64,
}

/// The camera.
pub struct UvcTwin {
    config: UvcConfig,
    scene: Arc<dyn Scene>,
    controls: Controls,
    negotiation: Negotiation,
    stream: Option<Sensor>,
    /// The frame that is being sent, and how much of it has gone.
    sending: Option<(Outgoing, usize)>,
    frame_id: u8,
    faults: Faults,
    log: Logbook,
    draws: Draws,
}

// === impl UvcConfig ===

impl UvcConfig {
    /// A camera with all formats.
    pub fn new(serial: &str) -> UvcConfig {
        UvcConfig { serial: serial.to_owned(), modes: Mode::ALL.into(), readout: Duration::from_millis(5), seed: 1 }
    }
}

// === impl UvcTwin ===

impl UvcTwin {
    /// A camera that has just been plugged in.
    pub fn new(config: UvcConfig, scene: Arc<dyn Scene>) -> UvcTwin {
        UvcTwin {
            negotiation: Negotiation::new(config.modes.clone()),
            draws: Draws::new(config.seed),
            config,
            scene,
            controls: Controls::power_up(),
            stream: None,
            sending: None,
            frame_id: 0,
            faults: Faults::default(),
            log: Logbook::default(),
        }
    }

    /// The faults in force, to be changed.
    pub fn faults(&mut self) -> &mut Faults {
        &mut self.faults
    }

    /// What it really did, frame by frame since it was made.
    pub fn truth(&self) -> &[Truth] {
        &self.log.truth
    }

    /// It streams.
    pub fn is_streaming(&self) -> bool {
        self.stream.is_some()
    }

    /// Settings that its controls hold now.
    pub fn settings(&self) -> Settings {
        self.controls.settings()
    }

    fn start(&mut self, agreed: Agreement, now: Instant) {
        self.stop();
        let Some(mode) = self.config.modes.get(agreed.mode).copied() else { return };
        let interval = Duration::from_nanos(u64::from(agreed.interval) * 100);
        let scene = Arc::clone(&self.scene);
        self.stream = Some(Sensor::new(scene, mode, (now, interval), self.config.readout, self.draws.clone()));
    }

    fn stop(&mut self) {
        if let Some(sensor) = self.stream.take() {
            self.draws = sensor.draws();
        }
        self.sending = None;
    }

    /// Lets the sensor work until `now` with the settings that were in force.
    fn advance(&mut self, now: Instant) {
        if let Some(sensor) = &mut self.stream {
            sensor.advance(now, self.controls.settings(), &self.faults, &mut self.log);
        }
    }

    /// The next payload: its header and as much of the picture as fits.
    fn payload(&mut self, length: usize) -> Option<Vec<u8>> {
        if self.sending.is_none() {
            let next = self.stream.as_mut()?.take()?;
            self.frame_id ^= FRAME_ID;
            self.sending = Some((next, 0));
        }
        let (frame, at) = self.sending.as_mut()?;
        let room = length.min(PAYLOAD).saturating_sub(HEADER);
        let end = (*at + room).min(frame.end);
        let last = end == frame.end;
        let mut flags = END_OF_HEADER | self.frame_id;
        flags |= if last { END_OF_FRAME } else { 0 };
        flags |= if frame.error && *at == 0 { ERROR } else { 0 };
        let mut out = Vec::with_capacity(HEADER + end - *at);
        out.extend([HEADER as u8, flags]);
        out.extend_from_slice(frame.bytes.get(*at..end).unwrap_or_default());
        *at = end;
        if last {
            self.sending = None;
        }
        Some(out)
    }
}

impl UsbTwin for UvcTwin {
    fn descriptors(&self) -> Descriptors {
        descriptors::descriptors(&self.config.modes, &self.config.serial)
    }

    fn control(&mut self, setup: SetupPacket, bytes: &[u8], now: Instant) -> Answer {
        if self.faults.frozen {
            return Answer::Nak;
        }
        self.advance(now);
        // Class requests to an interface.
        if setup.request_type & 0x7f != 0x21 {
            return Answer::Stall;
        }
        match setup.index as u8 {
            CONTROL_INTERFACE => self.controls.request(setup, bytes),
            STREAM_INTERFACE => match self.negotiation.request(setup, bytes) {
                Outcome::Answered(answer) => answer,
                Outcome::Committed(agreed) => {
                    self.start(agreed, now);
                    Answer::Data(Vec::new())
                }
            },
            _ => Answer::Stall,
        }
    }

    fn bulk_out(&mut self, _: u8, _: &[u8], _: Instant) -> Answer {
        Answer::Stall
    }

    fn bulk_in(&mut self, endpoint: u8, length: usize, now: Instant) -> Answer {
        if endpoint != STREAM {
            return Answer::Stall;
        }
        if self.faults.frozen {
            return Answer::Nak;
        }
        self.advance(now);
        if self.faults.mute {
            return Answer::Nak;
        }
        self.payload(length).map_or(Answer::Nak, Answer::Data)
    }

    /// Linux ends a bulk stream by clearing the halt of its endpoint.
    fn clear_halt(&mut self, endpoint: u8, _: Instant) {
        if endpoint == STREAM {
            self.stop();
        }
    }

    /// Plugged in anew: all settings are those of power-up.
    fn reset(&mut self, _: Instant) {
        self.stop();
        self.controls = Controls::power_up();
        self.negotiation = Negotiation::new(self.config.modes.clone());
    }

    fn due(&self) -> Option<Instant> {
        let sensor = self.stream.as_ref().filter(|_| !self.faults.frozen && !self.faults.mute)?;
        Some(if self.sending.is_some() || sensor.is_ready() { Instant::now() } else { sensor.due() })
    }
}
