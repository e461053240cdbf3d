//! Promise: a GigE Vision camera behind the real library is driven so that no frame ever carries a wrong label, none is
//! lost on the link, and a camera that dies is noticed and taken up again. The camera is the twin on loopback UDP.
//!
//! Counts are small by default; `GONIOD_FULL=1` runs the full ones. Needs `--features aravis` and `aravis-tools-cli`.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout)]

mod bench;
mod clients;
mod labels;
mod link;
mod losses;
mod strays;
mod streaming;
