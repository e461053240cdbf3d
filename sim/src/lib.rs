//! goniod-sim: the bench in software. Optics of its own (never the engine's), firmware twins that answer the devices'
//! bytes, cameras that photograph the true state and paint it into reserved rows, an oracle that reads it back.
//!
//! - [`bench`]: a whole bench from its files; [`truth`]: its optics, samples and the true answers
//! - [`firmware`]: devices as state machines; [`front`]: how they reach a link; [`twins`]: all of them together
//! - [`faults`]: what may go wrong, as a seeded plan; [`conformance`]: what every driver must bear
//! - [`gige`]: a GigE Vision camera on loopback; [`uvc`]: a USB camera, for the real drivers; [`scene`]: what they photograph
//! - [`served`]: a whole bench in real time for another process: ports in a folder, cameras on loopback, faults by a socket
//! - [`camera`], [`stream`]: cameras with their latency and queues
//! - [`paint`], [`oracle`]: the true state in the pixels, written and read; [`pose`]: what it consists of

pub mod bench;
pub mod camera;
pub mod conformance;
pub mod faults;
pub mod firmware;
pub mod front;
pub mod gige;
pub mod oracle;
pub mod paint;
pub mod pose;
pub mod scene;
pub mod served;
pub mod stream;
pub mod twins;
pub mod uvc;

/// The optics of the bench, its samples and the true answers, a crate of its own in `sim/src/truth/`.
pub use goniod_truth as truth;
