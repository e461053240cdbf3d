//! `goniod serve`: the queue of scans, carried out one run at a time, for as long as the machine is up.
//!
//! ```text
//! api/ ── queue ── worker ── start ── night ── sequencer
//!   │               │  │                         │ events
//!   └───── hub ─────┘  └── products              │
//!           └────────────────────────────────────┘
//! ```
//!
//! - [`entry`], [`queue`], [`snapshot`]: what is to be done, on the disk, with copies of its files
//! - [`settle`]: what the last daemon left; [`worker`], [`start`], [`products`]: carry it out
//! - [`hub`]: what is going on now; the middle between worker and clients
//! - [`lock`]: one at a time; [`safety`]: the safe state without a run; [`heart`]: signs of life to the service manager
//! - [`serve`]: the whole daemon

pub mod entry;
pub mod error;
pub mod heart;
pub mod hub;
pub mod lock;
pub mod products;
pub mod queue;
pub mod safety;
pub mod serve;
pub mod settle;
pub mod snapshot;
pub mod start;
pub mod worker;
