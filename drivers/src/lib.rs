//! goniod-drivers: what the daemon may ask of a device, and one file a device that asks it on the wire.
//!
//! - [`contract`]: the small traits (rotary axis, filter wheel, shutter, camera, monochromator, light monitor, spectrometer) and what every device can do
//! - [`error`]: one error type whose kind recovery can decide on
//! - [`frame`]: a picture with what the camera says about it, and the bounded pool its pixels come from
//! - [`units`]: angles and times as types
//! - [`clock`]: the one place where drivers and daemon read time and wait
//! - [`transport`]: byte links (serial port, in-memory pipe), the framings spoken over them, and USB pipes
//! - [`devices`]: the drivers, one file each
//! - [`table`]: the driver table, one line a driver
//! - [`conformance`]: what every driver must do, as checks that speak only to the contract

pub mod clock;
pub mod conformance;
pub mod contract;
pub mod devices;
pub mod error;
pub mod frame;
pub mod table;
pub mod transport;
pub mod units;
