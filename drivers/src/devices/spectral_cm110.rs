//! Driver `spectral-cm110`: monochromators CM110 and CM112 of Spectral Products.
//!
//! Source: CM110/112 manual, protocol sheet `spectralproducts-cm110`. The driver counts in angstroms and comes to every
//! wavelength from below. Other units in an agreed answer mean that the box restarted or somebody used the keypad: then
//! nothing is known until it is opened again.

use super::MonochromatorConfig;
use super::cm110_wire::{ANGSTROM, Cm110Wire, Query, Request};
use crate::clock::Clock;
use crate::contract::{Device, Health, Identity, Monochromator};
use crate::error::{ErrorKind, Result};
use crate::transport::Connector;
use crate::units::Nanometres;
use async_trait::async_trait;
use std::time::Duration;

/// Factory setting of the line.
pub const BAUD: u32 = 9600;
/// Slowest slew that deadlines allow for, nanometres a second (assumed; 50 to 100 are usual).
pub const SLOWEST_NM_PER_S: f64 = 20.0;
/// Added to every computed time of a move.
const MOVE_MARGIN: Duration = Duration::from_secs(5);
/// Time for a setting that moves nothing.
const SETTING_LIMIT: Duration = Duration::from_secs(1);
/// How far below the target a move from above first goes, against backlash (assumed).
pub const APPROACH: u16 = 50;
/// Longest wavelength of a grating with 1200 grooves a millimetre, nanometres (assumed); others in proportion.
pub const REACH_NM_AT_1200: f64 = 1200.0;
/// Commands for one move: an absolute move whose end is uncertain is sent once more after the state was asked.
const TRIES: u32 = 2;

/// A monochromator on its link.
pub struct Cm110 {
    wire: Cm110Wire,
    config: MonochromatorConfig,
    grating: Option<Grating>,
    /// Angstroms that a move of ours from below has proven.
    proven: Option<u16>,
}

/// The grating in use, as read at `open`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Grating {
    number: u16,
    grooves: u16,
}

// === impl Grating ===

impl Grating {
    /// Longest wavelength.
    fn reach(self) -> Nanometres {
        Nanometres(REACH_NM_AT_1200 * 1200.0 / f64::from(self.grooves.max(1)))
    }
}

// === impl Cm110 ===

impl Cm110 {
    /// A monochromator over `connector`; nothing is sent before `open`.
    pub fn new(connector: Box<dyn Connector>, config: MonochromatorConfig, clock: Clock) -> Cm110 {
        Cm110 { wire: Cm110Wire::new(&config.name, connector, clock), config, grating: None, proven: None }
    }

    /// A value whose status proves that the units are still ours.
    async fn ask(&mut self, query: Query) -> Result<u16> {
        let (value, status) = self.wire.query(query).await?;
        if status.units() == ANGSTROM {
            return Ok(value);
        }
        self.grating = None;
        self.proven = None;
        let what = format!(
            "its units are {} instead of angstroms: it restarted, or somebody used the keypad; open it again",
            ["micrometres", "nanometres"].get(usize::from(status.units())).unwrap_or(&"unknown")
        );
        Err(self.wire.error(ErrorKind::Broken, what))
    }

    fn check_open(&self) -> Result<Grating> {
        self.grating.ok_or_else(|| self.wire.error(ErrorKind::Refused, "the monochromator is not open; open it first"))
    }

    /// The target in angstroms, when it may be commanded.
    fn permitted(&self, target: Nanometres) -> Result<u16> {
        let (min, max) = self.limits();
        if target.0 >= min.0 && target.0 <= max.0 {
            return Ok((target.0 * 10.0).round() as u16);
        }
        let what = format!("{target} is refused; {min} to {max} is allowed by grating and instrument file");
        Err(self.wire.error(ErrorKind::Refused, what))
    }

    /// Goes to `angstroms` and proves it by asking. An uncertain end is followed by waiting until the box answers and
    /// asking where it stands.
    async fn go(&mut self, angstroms: u16, from: u16) -> Result<u16> {
        let distance_nm = f64::from(from.abs_diff(angstroms)) / 10.0;
        let limit = MOVE_MARGIN + Duration::from_secs_f64(distance_nm / SLOWEST_NM_PER_S);
        let tolerance = (self.config.tolerance.0 * 10.0).round();
        let mut failure = None;
        for _ in 0..TRIES {
            match self.wire.command(Request::Goto(angstroms), limit).await {
                Ok(_) => failure = None,
                Err(e) if matches!(e.kind, ErrorKind::Timeout | ErrorKind::Garbled | ErrorKind::Refused) => {
                    tracing::warn!(error = %e, "the end of a move is uncertain, asking where it stands");
                    failure = Some(e);
                }
                Err(e) => return Err(e),
            }
            let reached = self.ask(Query::Position).await?;
            if f64::from(reached.abs_diff(angstroms)) <= tolerance {
                return Ok(reached);
            }
            if failure.is_none() {
                let (at, wanted) = (nanometres(reached), nanometres(angstroms));
                let what = format!("stands at {at} instead of {wanted}, allowed is {} off", self.config.tolerance);
                return Err(self.wire.error(ErrorKind::Broken, what));
            }
        }
        Err(failure.unwrap_or_else(|| self.wire.error(ErrorKind::Broken, "does not reach its wavelength")))
    }

    async fn prepare_units(&mut self) -> Result<()> {
        for _ in 0..TRIES {
            if self.wire.query(Query::Units).await?.0 == u16::from(ANGSTROM) {
                return Ok(());
            }
            match self.wire.command(Request::Angstroms, SETTING_LIMIT).await {
                Err(e) if !matches!(e.kind, ErrorKind::Timeout | ErrorKind::Garbled) => return Err(e),
                _ => {}
            }
        }
        match self.wire.query(Query::Units).await?.0 {
            units if units == u16::from(ANGSTROM) => Ok(()),
            units => {
                Err(self.wire.error(ErrorKind::Broken, format!("does not keep angstroms, its units stay {units}")))
            }
        }
    }
}

#[async_trait]
impl Device for Cm110 {
    /// Counts in angstroms afterwards; nothing moves.
    async fn open(&mut self) -> Result<Identity> {
        (self.grating, self.proven) = (None, None);
        self.wire.ensure().await?;
        let serial = self.wire.query(Query::Serial).await?.0.to_string();
        if !self.config.serial.is_empty() && self.config.serial != serial {
            let what = format!(
                "it has serial number {serial}, the instrument file says {}; connect the right one or correct `serial`",
                self.config.serial
            );
            return Err(self.wire.error(ErrorKind::WrongDevice, what));
        }
        let gratings = self.wire.query(Query::Gratings).await?.0;
        let number = self.wire.query(Query::Grating).await?.0;
        let grooves = self.wire.query(Query::Grooves).await?.0;
        if grooves == 0 || number > gratings {
            let what = format!("it tells grating {number} of {gratings} with {grooves} grooves/mm, which cannot be");
            return Err(self.wire.error(ErrorKind::Broken, what));
        }
        self.prepare_units().await?;
        self.ask(Query::Position).await?;
        self.grating = Some(Grating { number, grooves });
        let model = format!("Spectral Products CM110/112, grating {number} of {gratings}, {grooves}/mm");
        Ok(Identity { model, firmware: String::new(), serial })
    }

    async fn health(&mut self) -> Result<Health> {
        let grating = self.check_open()?;
        let mut warnings = Vec::new();
        let position = self.ask(Query::Position).await?;
        if self.proven.is_some_and(|at| at != position) {
            self.proven = None;
            warnings.push(format!("stands at {}, where no command of ours brought it", nanometres(position)));
        }
        let number = self.ask(Query::Grating).await?;
        if number != grating.number {
            self.grating = None;
            warnings.push(format!("grating {number} instead of {} is in use; open it again", grating.number));
        }
        Ok(Health { warnings, temperature_c: None })
    }

    /// A monochromator is safe when it stands and answers: waits for the end of a move.
    async fn make_safe(&mut self) -> Result<()> {
        self.wire.ensure().await
    }
}

#[async_trait]
impl Monochromator for Cm110 {
    fn limits(&self) -> (Nanometres, Nanometres) {
        let reach = self.grating.map_or(self.config.max.0, |g| g.reach().0);
        (
            Nanometres(self.config.min.0.max(0.0)),
            Nanometres(self.config.max.0.min(reach).min(f64::from(u16::MAX) / 10.0)),
        )
    }

    async fn tune(&mut self, target: Nanometres) -> Result<Nanometres> {
        self.check_open()?;
        let angstroms = self.permitted(target)?;
        let mut from = self.ask(Query::Position).await?;
        if self.proven == Some(from) && from.abs_diff(angstroms) == 0 {
            return Ok(nanometres(from));
        }
        self.proven = None;
        let lowest = (self.limits().0.0 * 10.0).ceil() as u16;
        let below = angstroms.saturating_sub(APPROACH).max(lowest);
        if from >= angstroms && below < angstroms {
            from = self.go(below, from).await?;
        }
        let reached = self.go(angstroms, from).await?;
        self.wire.clock.sleep(self.config.settle).await;
        self.proven = Some(reached);
        Ok(nanometres(reached))
    }

    async fn wavelength(&mut self) -> Result<Option<Nanometres>> {
        self.check_open()?;
        self.ask(Query::Position).await.map(|at| Some(nanometres(at)))
    }
}

fn nanometres(angstroms: u16) -> Nanometres {
    Nanometres(f64::from(angstroms) / 10.0)
}
