//! What every driver must bear, tried on the twin of its device: the safe checks of the contract, and what needs a hand on
//! the wire. [`conform`] carries all of it out; no check speaks of a kind of device or of a protocol.
//!
//! - [`rig`]: a driver of the table on its twin; [`stand`], [`line`], [`truth`]: what may be done to the twin, and what is true
//! - [`trial`]: calls under a deadline, held against the truth
//! - [`wire`], [`losses`], [`conduct`], [`noise`]: the checks
//! - [`table`]: device by check, as text

pub mod conduct;
pub mod line;
pub mod losses;
pub mod noise;
pub mod rig;
pub mod stand;
pub mod table;
pub mod trial;
pub mod truth;
pub mod wire;

use goniod_drivers::clock::Clock;
use goniod_drivers::conformance::{Check, Finding, SAFE, Verdict, check};
use goniod_drivers::table::Driver;
use rig::Unit;
use trial::MakeRig;

/// How much is tried, and with which numbers.
#[derive(Debug, Clone, Copy)]
pub struct Effort {
    /// Random commands under noise.
    pub commands: u64,
    /// Exchanges under noise at least, however few a command needs.
    pub exchanges: u64,
    /// Seed of the noise.
    pub seed: u64,
}

/// What a driver did.
#[derive(Debug, Clone)]
pub struct Conduct {
    /// Name of the driver.
    pub driver: &'static str,
    /// How each check ended, in the order of [`checks`].
    pub findings: Vec<Finding>,
    /// What was counted under noise.
    pub noise: noise::Counts,
}

/// Another device is refused.
pub const WRONG_DEVICE: Check =
    Check { name: "another device", promise: "refuses another unit and every other device of the table on its port" };
/// Nothing happens before it is opened.
pub const CLOSED: Check =
    Check { name: "before opening", promise: "sends nothing and says nothing before it is opened" };
/// Nothing is sent for what is refused.
pub const NOTHING_SENT: Check = Check { name: "nothing sent", promise: "sends no byte for an order that it refuses" };
/// Power-up leaves it unknown.
pub const POWER_UP: Check =
    Check { name: "power-up", promise: "does not know its position after power-up, or says the true one" };
/// A device at work is not misled.
pub const BUSY: Check =
    Check { name: "busy", promise: "ordered or asked in the middle of a command, it refuses, waits or does it truly" };
/// Silence ends every call.
pub const SILENCE: Check =
    Check { name: "silence", promise: "every call ends by itself when the device falls silent after any byte" };
/// A late answer.
pub const LATE: Check = Check { name: "late", promise: "a late answer to any request misleads nobody" };
/// A lost answer.
pub const LOST: Check = Check { name: "lost", promise: "an answer that never comes, to any request" };
/// A cut answer.
pub const CUT: Check = Check { name: "cut", promise: "an answer that ends too early, at any byte" };
/// A garbled answer.
pub const GARBLED: Check = Check { name: "garbled", promise: "an answer with a wrong or a missing byte, anywhere" };
/// A doubled answer.
pub const DOUBLED: Check =
    Check { name: "doubled", promise: "an answer that comes twice, so that every later one is off by one" };
/// The previous answer.
pub const PREVIOUS: Check =
    Check { name: "previous", promise: "the answer to the request before instead of this one's" };
/// Junk.
pub const JUNK: Check = Check { name: "junk", promise: "junk on the line when it is opened, and before any answer" };
/// A restart in mid-command.
pub const RESTART: Check =
    Check { name: "restart", promise: "the power fails at any request or instant: unknown or true, never wrong" };
/// An unplugged adapter.
pub const UNPLUG: Check =
    Check { name: "unplug", promise: "pulled out in a command it is lost, and found again under another name" };
/// Noise.
pub const NOISE: Check =
    Check { name: "noise", promise: "random commands while answers are disturbed: nothing wrong is said" };

/// All checks of the suite in their order: the safe ones first.
pub fn checks() -> Vec<Check> {
    let wired = [
        WRONG_DEVICE,
        CLOSED,
        NOTHING_SENT,
        POWER_UP,
        BUSY,
        SILENCE,
        LATE,
        LOST,
        CUT,
        GARBLED,
        DOUBLED,
        PREVIOUS,
        JUNK,
        RESTART,
        UNPLUG,
        NOISE,
    ];
    SAFE.into_iter().chain(wired).collect()
}

/// Tries one driver: `make` gives fresh rigs of it, so that a test can put another driver in its place. Needs a runtime
/// whose time is paused.
pub async fn conform(driver: &'static Driver, make: &MakeRig<'_>, effort: Effort) -> Conduct {
    let mut findings = match make(Unit::Ours) {
        Some(mut rig) => check(&mut rig.subject, Clock::system(), &mut |_| ()).await,
        None => SAFE.map(|check| Finding { check, verdict: Verdict::Failed("the driver has no twin".into()) }).into(),
    };
    let mut add = |check: Check, verdict: Verdict| findings.push(Finding { check, verdict });
    add(WRONG_DEVICE, conduct::another_device(driver, make).await);
    add(CLOSED, Verdict::of(conduct::closed(make).await));
    add(NOTHING_SENT, conduct::nothing_sent(make).await);
    add(POWER_UP, Verdict::of(conduct::power_up(make).await));
    add(BUSY, Verdict::of(conduct::busy(make).await));
    add(SILENCE, losses::silence(make).await);
    for (check, faults) in wire::all() {
        add(check, wire::disturbed(make, &faults).await);
    }
    add(JUNK, Verdict::of(losses::junk(make).await));
    add(RESTART, losses::restart(make).await);
    add(UNPLUG, Verdict::of(losses::unplug(make).await));
    let (verdict, noise) = noise::random(make, effort).await;
    add(NOISE, verdict);
    Conduct { driver: driver.name, findings, noise }
}

// === impl Conduct ===

impl Conduct {
    /// The checks that failed, with where.
    pub fn failures(&self) -> Vec<String> {
        let failed = self.findings.iter().filter(|f| f.verdict.failed());
        failed.map(|f| format!("{}: {}: {}", self.driver, f.check.name, f.verdict.note())).collect()
    }
}
