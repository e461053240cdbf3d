//! Driver `thorlabs-sc10`: shutter controller SC10 with a head that senses its blade.
//!
//! Source: SC10 manual 8654-D02, command page. `ens` toggles, so it is sent only after the state was asked, never twice
//! without asking between. Never sent: `baud`, `save`, `savp`, `resp`, `default`.

use super::prompt::PromptWire;
use crate::clock::Clock;
use crate::contract::{Device, Health, Identity, Shutter, ShutterState};
use crate::error::{ErrorKind, Result};
use crate::transport::Connector;
use async_trait::async_trait;
use std::time::Duration;

/// Factory setting of the line.
pub const BAUD: u32 = 9600;
/// The prompt after a toggle.
const TOGGLE_LIMIT: Duration = Duration::from_millis(500);
/// Rounds of asking and toggling before a change of state is given up.
const ROUNDS: u32 = 3;
/// Longest wait for the blade after the controller has accepted the state.
const BLADE_LIMIT: Duration = Duration::from_millis(200);
/// Pause between looks at the blade.
const BLADE_POLL: Duration = Duration::from_millis(10);
/// Manual mode: enabled = open.
const MANUAL: u8 = 1;

/// What the instrument file says about the shutter.
#[derive(Debug, Clone, PartialEq)]
pub struct ShutterConfig {
    /// Name in the instrument file.
    pub name: String,
    /// Wait after each change.
    pub settle: Duration,
}

/// A shutter on its link.
pub struct Sc10 {
    wire: PromptWire,
    config: ShutterConfig,
    open: bool,
}

// === impl Sc10 ===

impl Sc10 {
    /// A shutter over `connector`; nothing is sent before `open`.
    pub fn new(connector: Box<dyn Connector>, config: ShutterConfig, clock: Clock) -> Sc10 {
        Sc10 { wire: PromptWire::new(&config.name, connector, clock), config, open: false }
    }

    /// A query whose answer is 0 or 1.
    async fn flag(&mut self, query: &str) -> Result<bool> {
        match self.wire.value(query).await?.as_str() {
            "0" => Ok(false),
            "1" => Ok(true),
            other => Err(self.wire.error(ErrorKind::Garbled, format!("`{query}` gave {other:?}, 0 or 1 is needed"))),
        }
    }

    /// What must hold before light may pass.
    async fn check_may_open(&mut self) -> Result<()> {
        if self.flag("interlock?").await? {
            let what = "the interlock is tripped and holds the shutter closed; close the interlock contact";
            return Err(self.wire.error(ErrorKind::Refused, what));
        }
        match self.wire.number("mode?").await? {
            MANUAL => Ok(()),
            mode => {
                let what =
                    format!("somebody set mode {mode}, mode 1 (manual) is needed; open the shutter device again");
                Err(self.wire.error(ErrorKind::Broken, what))
            }
        }
    }

    /// Brings enable to `enabled`. The toggle is sent only on a proven difference; a lost prompt leads to the next
    /// round, which begins with asking.
    async fn bring_enable(&mut self, enabled: bool) -> Result<()> {
        for _ in 0..ROUNDS {
            if self.flag("ens?").await? == enabled {
                return Ok(());
            }
            match self.wire.exchange("ens", TOGGLE_LIMIT).await {
                Ok(_) => {}
                Err(error) if matches!(error.kind, ErrorKind::Timeout | ErrorKind::Garbled) => {
                    tracing::warn!(%error, "the answer to a toggle was lost, asking for the state");
                }
                Err(error) => return Err(error),
            }
        }
        if self.flag("ens?").await? == enabled {
            return Ok(());
        }
        let what =
            format!("enable does not become {} in {ROUNDS} rounds; check interlock and front panel", u8::from(enabled));
        Err(self.wire.error(ErrorKind::Broken, what))
    }

    /// Waits until the blade's sensor agrees.
    async fn prove_blade(&mut self, state: ShutterState) -> Result<()> {
        let deadline = self.wire.clock.now() + BLADE_LIMIT;
        loop {
            if self.flag("closed?").await? == (state == ShutterState::Closed) {
                return Ok(());
            }
            if self.wire.clock.now() > deadline {
                let what = format!(
                    "told to be {state:?}, its sensor says otherwise after 0.2 s: blade stuck or sensor dead; check the head"
                );
                return Err(self.wire.error(ErrorKind::Broken, what));
            }
            self.wire.clock.sleep(BLADE_POLL).await;
        }
    }

    async fn bring(&mut self, state: ShutterState) -> Result<()> {
        self.bring_enable(state == ShutterState::Open).await?;
        self.prove_blade(state).await
    }

    fn check_open(&self) -> Result<()> {
        if self.open {
            Ok(())
        } else {
            Err(self.wire.error(ErrorKind::Lost, "the shutter device is not open; open it first"))
        }
    }
}

#[async_trait]
impl Device for Sc10 {
    /// Leaves the shutter closed, in manual mode.
    async fn open(&mut self) -> Result<Identity> {
        self.open = false;
        self.wire.ensure().await?;
        let text = self.wire.value("id?").await?;
        if !text.contains("SC10") {
            let what = format!("it says {text:?}, a Thorlabs SC10 is needed; connect the shutter or correct `port`");
            return Err(self.wire.error(ErrorKind::WrongDevice, what));
        }
        self.bring_enable(false).await?;
        self.wire.write("mode", MANUAL).await?;
        self.bring(ShutterState::Closed).await?;
        self.open = true;
        let firmware = text.rsplit(' ').next().unwrap_or_default().to_owned();
        Ok(Identity { model: "Thorlabs SC10".to_owned(), firmware, serial: String::new() })
    }

    async fn health(&mut self) -> Result<Health> {
        self.check_open()?;
        let mut warnings = Vec::new();
        if self.flag("interlock?").await? {
            warnings.push("interlock tripped".to_owned());
        }
        if self.wire.number("mode?").await? != MANUAL {
            warnings.push("not in manual mode".to_owned());
        }
        if self.flag("ens?").await? == self.flag("closed?").await? {
            warnings.push("blade and command disagree".to_owned());
        }
        if self.wire.unsolicited > 0 {
            warnings.push(format!("{} times bytes came unasked", self.wire.unsolicited));
        }
        Ok(Health { warnings, temperature_c: None })
    }

    /// Closed and disabled, whatever mode and interlock say.
    async fn make_safe(&mut self) -> Result<()> {
        self.wire.ensure().await?;
        self.bring(ShutterState::Closed).await
    }
}

#[async_trait]
impl Shutter for Sc10 {
    async fn set(&mut self, state: ShutterState) -> Result<()> {
        self.check_open()?;
        if state == ShutterState::Open {
            self.check_may_open().await?;
        }
        if self.state().await? == Some(state) {
            return Ok(());
        }
        self.bring(state).await?;
        self.wire.clock.sleep(self.config.settle).await;
        Ok(())
    }

    async fn state(&mut self) -> Result<Option<ShutterState>> {
        self.check_open()?;
        let enabled = self.flag("ens?").await?;
        let closed = self.flag("closed?").await?;
        Ok(match (enabled, closed) {
            (true, false) => Some(ShutterState::Open),
            (false, true) => Some(ShutterState::Closed),
            _ => None,
        })
    }
}
