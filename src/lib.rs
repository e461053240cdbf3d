//! goniod runs a video-goniophotometer through the night and gives back, in the morning, the BSDF of a window, blind
//! or film with its uncertainty.
//!
//! ```text
//! scan.toml + instrument.toml + calibration                                        config/
//!    -> plan -> sequencer -> devices -> drivers -> (wire) -> hardware or sim       control/
//!                               |
//!    frame -> guard -> archive (fsync, journal) -> radiometry -> BSDF -> export, report
//!                      archive/                    engine/               products/
//! ```
//!
//! - [`archive`]: the run directory, the only code that writes run files
//! - [`config`]: what people write becomes checked values
//! - [`control`]: what happens in the night
//! - [`digest`]: what names the content of a file
//! - [`engine`]: what the pictures mean
//! - [`front`]: what people touch
//! - [`products`]: what people take away

pub mod archive;
pub mod config;
pub mod control;
pub mod digest;
pub mod front;
pub mod products;

/// The radiance and BSDF engine, a crate of its own in `src/engine/`.
pub use goniod_engine as engine;
