//! The camera as the daemon sees it: commands with deadlines to the thread, frames out of a bounded channel.

use super::config::V4l2Config;
use super::flight::Counters;
use super::worker::{Command, Reply, Worker};
use crate::clock::Clock;
use crate::contract::{Armed, Camera, CameraInfo, CameraSettings, Device, Health, Identity};
use crate::error::{DeviceError, ErrorKind, Result};
use crate::frame::{Frame, PixelFormat};
use crate::units::ExposureTime;
use async_trait::async_trait;
use std::sync::Arc;
use std::sync::atomic::AtomicUsize;
use std::time::Duration;
use tokio::sync::oneshot;

/// Added to the thread's own deadline for a frame; reached only when the thread itself hangs.
const BACKSTOP: Duration = Duration::from_secs(3);

/// A camera behind a V4L2 node.
pub struct V4l2Camera {
    config: Arc<V4l2Config>,
    clock: Clock,
    info: CameraInfo,
    worker: Option<Worker>,
    alive: Arc<AtomicUsize>,
    generation: u64,
    due_within: Duration,
}

// === impl V4l2Camera ===

impl V4l2Camera {
    /// A camera that is opened by [`Device::open`].
    pub fn new(config: V4l2Config, clock: Clock) -> V4l2Camera {
        let info = CameraInfo {
            identity: Identity { model: config.card.clone(), firmware: String::new(), serial: config.serial.clone() },
            width: config.width as usize,
            height: config.height as usize,
            format: config.format.unwrap_or(PixelFormat::Mono8),
            shortest: ExposureTime::from_seconds(config.shortest_s),
            longest: ExposureTime::from_seconds(config.longest_s),
        };
        V4l2Camera {
            config: Arc::new(config),
            clock,
            info,
            worker: None,
            alive: Arc::default(),
            generation: 0,
            due_within: Duration::ZERO,
        }
    }

    /// What was odd about frames since the camera was opened.
    pub async fn counters(&mut self) -> Result<Counters> {
        self.ask(Command::Counters).await
    }

    fn error(&self, kind: ErrorKind, message: impl Into<String>) -> DeviceError {
        DeviceError::new(kind, &self.config.name, message)
    }

    /// One command and its answer. A thread that does not answer in time hangs in the kernel: it is left to itself
    /// (it ends when the call returns) and the camera counts as lost until `open` starts a new one.
    async fn ask<T>(&mut self, command: impl FnOnce(Reply<T>) -> Command) -> Result<T> {
        let Some(worker) = self.worker.as_ref() else {
            return Err(self.error(ErrorKind::Lost, "the camera is not open; open it first"));
        };
        let (reply, answer) = oneshot::channel();
        let commands = worker.commands.clone();
        let command = command(reply);
        let exchange = async move {
            commands.send(command).await.ok()?;
            answer.await.ok()
        };
        match self.clock.timeout(self.config.command_limit, exchange).await {
            Ok(Some(result)) => result,
            Ok(None) => {
                self.worker = None;
                Err(self.error(ErrorKind::Lost, "the camera's thread has ended; open the camera again"))
            }
            Err(_) => {
                self.worker = None;
                let limit = self.config.command_limit.as_secs_f64();
                let message =
                    format!("a call to the camera's driver hangs for {limit} s and is left; open the camera again");
                Err(self.error(ErrorKind::Timeout, message))
            }
        }
    }

    /// Throws away what waits for a reader.
    fn drain(&mut self) {
        if let Some(worker) = self.worker.as_mut() {
            while worker.frames.try_recv().is_ok() {}
        }
    }
}

#[async_trait]
impl Device for V4l2Camera {
    async fn open(&mut self) -> Result<Identity> {
        // The old thread closes its node before a new one opens it, unless it hangs.
        if self.worker.is_none() {
            self.worker = Some(Worker::start(&self.config, self.clock, &self.alive)?);
        }
        self.drain();
        self.info = self.ask(Command::Open).await?;
        Ok(self.info.identity.clone())
    }

    async fn health(&mut self) -> Result<Health> {
        self.ask(Command::Health).await
    }

    async fn make_safe(&mut self) -> Result<()> {
        self.stop().await
    }
}

#[async_trait]
impl Camera for V4l2Camera {
    fn info(&self) -> &CameraInfo {
        &self.info
    }

    async fn apply(&mut self, settings: CameraSettings) -> Result<CameraSettings> {
        let (applied, format) = self.ask(|reply| Command::Apply(settings, reply)).await?;
        self.info.format = format;
        Ok(applied)
    }

    async fn arm(&mut self) -> Result<Armed> {
        self.generation += 1;
        let generation = self.generation;
        self.drain();
        let armed = self.ask(|reply| Command::Arm(generation, reply)).await?;
        self.due_within = armed.due_within;
        Ok(armed)
    }

    async fn next_frame(&mut self) -> Result<Frame> {
        let limit = self.due_within + BACKSTOP;
        let generation = self.generation;
        let Some(worker) = self.worker.as_mut() else {
            return Err(self.error(ErrorKind::Lost, "the camera is not open; open it first"));
        };
        let current = async {
            loop {
                match worker.frames.recv().await {
                    Some((of, item)) if of == generation => return Some(item),
                    Some(_) => {}
                    None => return None,
                }
            }
        };
        match self.clock.timeout(limit, current).await {
            Ok(Some(item)) => item,
            Ok(None) => {
                self.worker = None;
                Err(self.error(ErrorKind::Lost, "the camera's thread has ended; open the camera again"))
            }
            Err(_) => {
                let message = format!("no picture within {:.1} s", limit.as_secs_f64());
                Err(self.error(ErrorKind::Timeout, message))
            }
        }
    }

    async fn stop(&mut self) -> Result<()> {
        if self.worker.is_none() {
            return Ok(());
        }
        let stopped = self.ask(Command::Stop).await;
        self.drain();
        stopped
    }
}
