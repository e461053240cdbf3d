//! Promise: a camera behind V4L2 gives frames under their true labels, or none. The driver and crate `v4l` run whole, on a
//! camera in software behind the C library's doors (`shim`), so this needs neither video devices nor kernel modules.
//!
//! The device thread is a real one and the twin brings its own clock, so tokio's clock is not paused here: commands
//! answer within milliseconds of real time whatever the exposure is. `GONIOD_FULL=1` runs the full counts.

#![allow(unsafe_code)] // the twin stands behind C's doors
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stderr, clippy::missing_safety_doc)]

mod bench;
mod conformance;
mod faults;
mod labels;
mod settings;
mod shim;
