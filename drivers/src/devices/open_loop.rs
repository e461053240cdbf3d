//! Shutters that only listen: no reply, no sensor. What can be known is what was last sent over a living link.
//!
//! The state is `None` until the first order after `open`, and again after every failure. An order is absolute, so it
//! is sent twice, 50 ms apart: one lost byte does no harm. That the blade really moved is proven by the pictures: dark
//! frames must be dark, lit ones lit.

use super::thorlabs_sc10::ShutterConfig;
use crate::clock::Clock;
use crate::contract::{Device, Health, Identity, Shutter, ShutterState};
use crate::error::{DeviceError, ErrorKind, Result};
use crate::transport::{Connector, Link};
use async_trait::async_trait;
use std::time::Duration;

/// Time between an order and its repetition.
const REPEAT: Duration = Duration::from_millis(50);
/// Quiet time after opening the port.
const QUIET: Duration = Duration::from_millis(100);

/// What one kind of device takes.
#[derive(Debug, Clone, Copy)]
pub(super) struct Orders {
    /// Name for the identity.
    pub model: &'static str,
    /// Lets light pass.
    pub open: &'static [u8],
    /// Stops the light.
    pub close: &'static [u8],
    /// Longest travel of the blade.
    pub travel: Duration,
}

/// A shutter without feedback on its link.
pub(super) struct OpenLoop {
    connector: Box<dyn Connector>,
    link: Option<Link>,
    orders: Orders,
    config: ShutterConfig,
    clock: Clock,
    label: String,
    commanded: Option<ShutterState>,
    unsolicited: u64,
}

// === impl OpenLoop ===

impl OpenLoop {
    /// A shutter over `connector`; nothing is sent before `open`.
    pub(super) fn new(orders: Orders, connector: Box<dyn Connector>, config: ShutterConfig, clock: Clock) -> OpenLoop {
        let label = format!("{} ({})", config.name, connector.port());
        OpenLoop { connector, link: None, orders, config, clock, label, commanded: None, unsolicited: 0 }
    }

    fn error(&self, kind: ErrorKind, message: impl Into<String>) -> DeviceError {
        DeviceError::new(kind, &self.label, message)
    }

    /// The link, seen to live a moment ago. Bytes that come are counted: these devices never speak.
    async fn living(&mut self) -> Result<&mut Link> {
        let label = self.label.clone();
        let early = match self.link.as_mut() {
            Some(link) => link.unsolicited().await,
            None => Err(DeviceError::new(ErrorKind::Lost, &label, "the shutter is not connected; open it first")),
        };
        match early {
            Ok(0) => {}
            Ok(_) => self.unsolicited += 1,
            Err(error) => return Err(self.lose(error)),
        }
        if let Some(link) = self.link.as_mut().filter(|_| early != Ok(0)) {
            link.drain(Duration::ZERO).await?;
        }
        self.link.as_mut().ok_or_else(|| DeviceError::new(ErrorKind::Lost, label, "the link is gone; open it again"))
    }

    fn lose(&mut self, error: DeviceError) -> DeviceError {
        self.link = None;
        self.commanded = None;
        self.error(error.kind, error.message)
    }

    /// Sends an order twice and waits for the blade.
    async fn send(&mut self, state: ShutterState) -> Result<()> {
        self.commanded = None;
        let bytes = match state {
            ShutterState::Open => self.orders.open,
            ShutterState::Closed => self.orders.close,
        };
        for pause in [REPEAT, self.orders.travel] {
            let sent = self.living().await?.send(bytes).await;
            sent.map_err(|e| self.lose(e))?;
            self.clock.sleep(pause).await;
        }
        // A link that died meanwhile carried nothing.
        self.living().await?;
        self.commanded = Some(state);
        Ok(())
    }
}

#[async_trait]
impl Device for OpenLoop {
    /// Leaves the shutter told to close. `WrongDevice` when the port answers: these devices cannot.
    async fn open(&mut self) -> Result<Identity> {
        self.link = None;
        self.commanded = None;
        self.unsolicited = 0;
        let connected = self.connector.connect().await;
        self.link = Some(connected.map_err(|e| self.error(e.kind, e.message))?);
        // First the order: opening a port may have sent a byte that opened the blade.
        self.send(ShutterState::Closed).await?;
        if let Some(link) = self.link.as_mut() {
            self.unsolicited += u64::from(link.drain(QUIET).await? > 0);
        }
        if self.unsolicited > 0 {
            self.link = None;
            self.commanded = None;
            let what = format!("something at this port answers, a {} never does; correct `port`", self.orders.model);
            return Err(self.error(ErrorKind::WrongDevice, what));
        }
        Ok(Identity {
            model: format!("{} (no feedback)", self.orders.model),
            firmware: String::new(),
            serial: String::new(),
        })
    }

    async fn health(&mut self) -> Result<Health> {
        self.living().await?;
        let mut warnings = Vec::new();
        if self.commanded.is_none() {
            warnings.push("its state is not known".to_owned());
        }
        if self.unsolicited > 0 {
            warnings.push(format!("{} times bytes came from a device that never speaks", self.unsolicited));
        }
        Ok(Health { warnings, temperature_c: None })
    }

    /// Told to close, over a fresh link where the old one is dead. There is no proof on the wire.
    async fn make_safe(&mut self) -> Result<()> {
        if self.living().await.is_err() {
            let connected = self.connector.connect().await;
            self.link = Some(connected.map_err(|e| self.error(e.kind, e.message))?);
        }
        self.send(ShutterState::Closed).await
    }
}

#[async_trait]
impl Shutter for OpenLoop {
    async fn set(&mut self, state: ShutterState) -> Result<()> {
        self.send(state).await?;
        self.clock.sleep(self.config.settle).await;
        Ok(())
    }

    /// What was last commanded since `open`, while the link lives.
    async fn state(&mut self) -> Result<Option<ShutterState>> {
        self.living().await?;
        Ok(self.commanded)
    }
}
