//! The sensor thread: exposes on trigger or freely, with the pipeline a real sensor has, and sends what it saw.

use super::address as a;
use super::control::destination;
use super::faults::{Draws, Faults, FrameFault, Truth};
use super::gvsp::{self, Block};
use super::pixel::PixelCode;
use super::shared::{Order, Shared, pause};
use super::xml::CHUNK_IDS;
use crate::scene::ExposureRequest;
use std::collections::VecDeque;
use std::net::UdpSocket;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::Duration;
use tokio::time::Instant;

/// Longest pipeline of settings that can be simulated.
const LONGEST_PIPELINE: usize = 16;

/// An exposure under way, with what the registers said when it began.
struct Exposure {
    request: ExposureRequest,
    /// The integration time of the lines that still use the old value.
    half_with_us: Option<f64>,
    commanded_us: f64,
    ends: Instant,
    format: PixelCode,
    chunks: [bool; 3],
    chunk_mode: bool,
}

/// A picture as it left the sensor.
#[derive(Clone)]
struct Picture {
    frame_number: u64,
    exposure_us: f64,
    stamp: u64,
    format: PixelCode,
    size: (u32, u32),
    image: Arc<Vec<u8>>,
}

/// One twin's sensor side.
pub struct SensorThread {
    shared: Arc<Shared>,
    socket: UdpSocket,
    orders: Receiver<Order>,
    running: bool,
    exposing: Option<Exposure>,
    next_free_start: Instant,
    commanded: VecDeque<f64>,
    last_used_us: Option<f64>,
    frame_number: u64,
    /// Blocks that went to the host in control since it took it.
    host_count: u64,
    block_id: u16,
    sequence: u64,
    /// The picture exposed last, sent or not.
    before: Option<Picture>,
    /// The picture sent whole last.
    sent: Option<Picture>,
    levels: Vec<u16>,
    packet: Vec<u8>,
    frame_draws: Draws,
    loss_draws: Draws,
}

// === impl SensorThread ===

impl SensorThread {
    /// A sensor that has just been powered up.
    pub fn new(shared: Arc<Shared>, socket: UdpSocket, orders: Receiver<Order>) -> SensorThread {
        let seed = shared.config.seed;
        SensorThread {
            shared,
            socket,
            orders,
            running: false,
            exposing: None,
            next_free_start: Instant::now(),
            commanded: VecDeque::new(),
            last_used_us: None,
            frame_number: 0,
            host_count: 0,
            block_id: 0,
            sequence: 0,
            before: None,
            sent: None,
            levels: Vec::new(),
            packet: Vec::new(),
            frame_draws: Draws::new(seed),
            loss_draws: Draws::new(seed ^ 0x10_55),
        }
    }

    /// Works until told to quit.
    pub fn run(mut self) {
        loop {
            let wait = match (&self.exposing, self.free_running()) {
                (Some(exposure), _) => exposure.ends.saturating_duration_since(Instant::now()),
                (None, true) => self.next_free_start.saturating_duration_since(Instant::now()),
                (None, false) => Duration::from_millis(100),
            };
            match self.orders.recv_timeout(wait) {
                Ok(Order::Quit) | Err(RecvTimeoutError::Disconnected) => return,
                Ok(order) => self.obey(order),
                Err(RecvTimeoutError::Timeout) => {}
            }
            if !self.shared.alive() {
                return;
            }
            self.advance();
        }
    }

    fn free_running(&self) -> bool {
        self.running && self.shared.registers().get(a::TRIGGER_MODE) == 0
    }

    fn obey(&mut self, order: Order) {
        match order {
            Order::Start => {
                self.running = true;
                self.block_id = 0;
                if self.shared.taken.swap(false, Ordering::SeqCst) {
                    self.host_count = 0;
                }
                self.next_free_start = Instant::now();
            }
            Order::Stop | Order::Quit => {
                self.running = false;
                self.exposing = None;
            }
            Order::Trigger if self.running && self.exposing.is_none() && !self.free_running() => self.expose(),
            Order::Trigger => self.shared.traffic().triggers_ignored += 1,
        }
    }

    fn advance(&mut self) {
        let now = Instant::now();
        if self.exposing.as_ref().is_some_and(|e| e.ends <= now)
            && let Some(exposure) = self.exposing.take()
        {
            self.finish(exposure);
        }
        if self.exposing.is_none() && self.free_running() && self.next_free_start <= Instant::now() {
            self.expose();
        }
    }

    /// Begins an exposure with the settings that have come through the pipeline.
    fn expose(&mut self) {
        let faults = self.shared.faults().clone();
        let registers = self.shared.registers();
        let commanded_us = registers.get_f64(a::EXPOSURE);
        self.commanded.push_front(commanded_us);
        self.commanded.truncate(LONGEST_PIPELINE + 1);
        let depth = (faults.latency_frames as usize).min(self.commanded.len() - 1);
        let exposure_us = self.commanded.get(depth).copied().unwrap_or(commanded_us);
        let changed = self.last_used_us.filter(|last| *last != exposure_us);
        self.last_used_us = Some(exposure_us);
        self.frame_number += 1;
        let started = Instant::now();
        let format = registers.format();
        let config = &self.shared.config;
        let took = if config.real_exposure {
            Duration::from_secs_f64(exposure_us * 1e-6) + config.readout
        } else {
            Duration::ZERO
        };
        self.exposing = Some(Exposure {
            request: ExposureRequest {
                frame_number: self.frame_number,
                host_count: self.host_count + 1,
                exposure_us,
                gain_db: registers.get_f64(a::GAIN),
                started,
                width: registers.get(a::WIDTH) as usize,
                height: registers.get(a::HEIGHT) as usize,
                max_level: format.max_level(),
            },
            half_with_us: changed.filter(|_| faults.half_changed),
            commanded_us,
            ends: started + took,
            format,
            chunks: registers.chunks(),
            chunk_mode: registers.get(a::CHUNK_ACTIVE) == 1,
        });
        let fps = if registers.get(a::FRAME_RATE_ENABLE) == 1 {
            registers.get_f64(a::FRAME_RATE).max(0.01)
        } else {
            config.sensor.max_fps
        };
        self.next_free_start = (self.next_free_start + Duration::from_secs_f64(1.0 / fps)).max(started);
    }

    /// Reads the sensor out and sends the block, with the frame faults that fall due.
    fn finish(&mut self, exposure: Exposure) {
        let picture = self.photograph(&exposure);
        let faults = self.shared.faults().clone();
        let mut fault = exposure.half_with_us.map(|_| FrameFault::HalfChanged);
        let mut shown = picture.clone();
        let ordered = self.shared.faults().next.pop_front();
        if ordered.is_some() {
            (shown, fault) = (self.ordered(ordered, &picture), ordered);
        } else if self.frame_draws.happens(faults.stale_per_1000)
            && let Some(before) = self.before.clone()
        {
            (shown, fault) = (before, Some(FrameFault::Stale));
        } else if self.frame_draws.happens(faults.repeated_per_1000)
            && let Some(sent) = self.sent.clone()
        {
            shown = Picture { stamp: picture.stamp, ..sent };
            fault = Some(FrameFault::Repeated);
        } else if self.frame_draws.happens(faults.short_per_1000) {
            fault = Some(FrameFault::Short);
        }
        self.before = Some(picture);
        if !matches!(fault, Some(FrameFault::Short | FrameFault::NoFrame)) {
            self.sent = Some(shown.clone());
        }
        if fault == Some(FrameFault::SkippedId) {
            self.next_block();
        }
        let block = self.block(&exposure, &shown, fault == Some(FrameFault::Short));
        self.sequence += 1;
        self.shared.truth().push(Truth {
            sequence: self.sequence,
            block_id: block.id,
            frame_number: shown.frame_number,
            exposure_us: shown.exposure_us,
            commanded_us: exposure.commanded_us,
            fault,
        });
        if let Some(FrameFault::Late(by)) = fault {
            self.linger(by);
        }
        if fault != Some(FrameFault::NoFrame) {
            self.shared.keep(block.clone());
        }
        if !faults.mute && fault != Some(FrameFault::NoFrame) {
            self.send(&block, &faults);
        }
        if self.shared.registers().get(a::ACQUISITION_MODE) == 1 {
            self.running = false;
            self.shared.registers().acquiring = false;
        }
    }

    /// The picture that is sent where a fault was ordered for this frame.
    fn ordered(&self, fault: Option<FrameFault>, picture: &Picture) -> Picture {
        let shown = match fault {
            Some(FrameFault::Stale) => self.before.clone(),
            Some(FrameFault::Repeated) => self.sent.clone().map(|sent| Picture { stamp: picture.stamp, ..sent }),
            Some(FrameFault::Black) => {
                Some(Picture { image: Arc::new(vec![0; picture.image.len()]), ..picture.clone() })
            }
            _ => None,
        };
        shown.unwrap_or_else(|| picture.clone())
    }

    /// Waits, or until the camera is switched off.
    fn linger(&self, time: Duration) {
        let until = Instant::now() + time;
        while Instant::now() < until && self.shared.alive() {
            pause(Duration::from_millis(5).min(until.saturating_duration_since(Instant::now())));
        }
    }

    fn photograph(&mut self, exposure: &Exposure) -> Picture {
        let request = &exposure.request;
        self.levels.resize(request.width * request.height, 0);
        self.shared.scene.render(request, &mut self.levels);
        if let Some(exposure_us) = exposure.half_with_us {
            let mut old = vec![0; self.levels.len()];
            self.shared.scene.render(&ExposureRequest { exposure_us, ..request.clone() }, &mut old);
            let half = request.height / 2 * request.width;
            if let (Some(upper), Some(source)) = (self.levels.get_mut(..half), old.get(..half)) {
                upper.copy_from_slice(source);
            }
        }
        let mut image = Vec::with_capacity(exposure.format.bytes(self.levels.len()) + 64);
        exposure.format.encode(&self.levels, &mut image);
        Picture {
            frame_number: request.frame_number,
            exposure_us: request.exposure_us,
            stamp: self.shared.ticks(request.started),
            format: exposure.format,
            size: (request.width as u32, request.height as u32),
            image: Arc::new(image),
        }
    }

    fn next_block(&mut self) {
        self.block_id = self.block_id.checked_add(1).unwrap_or(1);
        self.host_count += 1;
    }

    fn block(&mut self, exposure: &Exposure, shown: &Picture, cut: bool) -> Block {
        self.next_block();
        let payload = if exposure.chunk_mode {
            let mut payload = shown.image.to_vec();
            let length = payload.len();
            gvsp::close_chunk(&mut payload, CHUNK_IDS[0], length);
            let values = [shown.exposure_us.to_be_bytes(), shown.stamp.to_be_bytes(), shown.frame_number.to_be_bytes()];
            for ((id, value), on) in CHUNK_IDS[1..].iter().zip(values).zip(exposure.chunks) {
                if on {
                    gvsp::push_chunk(&mut payload, *id, &value);
                }
            }
            Arc::new(payload)
        } else {
            Arc::clone(&shown.image)
        };
        let (_, packet_size) = destination(&self.shared);
        Block {
            id: self.block_id,
            stamp: shown.stamp,
            format: shown.format.code(),
            width: shown.size.0,
            height: shown.size.1,
            chunks: exposure.chunk_mode,
            cut_at: cut.then_some(payload.len() / 2),
            payload,
            packet_size,
        }
    }

    fn send(&mut self, block: &Block, faults: &Faults) {
        let (to, _) = destination(&self.shared);
        if to.port() == 0 {
            return;
        }
        let delay = Duration::from_nanos(u64::from(self.shared.registers().get(a::PACKET_DELAY)));
        let mut owed = Duration::ZERO;
        let (mut packets, mut dropped) = (0, 0);
        for n in (0..=block.trailer()).filter(|n| block.has(*n)) {
            packets += 1;
            if self.loss_draws.happens(faults.drop_per_1000) {
                dropped += 1;
            } else {
                block.packet(n, &mut self.packet);
                let _ = self.socket.send_to(&self.packet, to);
            }
            owed += delay;
            if owed >= Duration::from_micros(100) {
                pause(owed);
                owed = Duration::ZERO;
            }
            if let Some((every, rest)) = self.shared.config.pace
                && delay.is_zero()
                && (n + 1).is_multiple_of(every.max(1))
            {
                pause(rest);
            }
        }
        let mut traffic = self.shared.traffic();
        traffic.blocks += 1;
        traffic.packets += packets;
        traffic.dropped += dropped;
    }
}
