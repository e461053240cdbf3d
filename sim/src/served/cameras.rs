//! Cameras of a served bench: GigE Vision twins before the bench, each on a loopback address of its own.

use super::ServeError;
use crate::bench::Bench;
use crate::gige::{GigeTwin, PixelCode, Sensor, TwinConfig};
use goniod_drivers::devices::CameraConfig;
use std::io;
use std::net::Ipv4Addr;
use std::sync::Arc;
use std::time::Duration;

/// Longest serial number that the register of a GigE Vision camera holds, in bytes.
const LONGEST_SERIAL: usize = 15;
/// Addresses tried before it is given up.
const ADDRESSES: u32 = 250;

/// Switches a camera of the bench on, at the first address from `first` on that nobody has.
///
/// # Errors
/// [`ServeError`]: a camera that the bench has not or has otherwise, no free address.
pub fn start(
    name: &str,
    site: &CameraConfig,
    bench: &Bench,
    seed: u64,
    first: Ipv4Addr,
) -> Result<GigeTwin, ServeError> {
    let wrong = |message: String| ServeError::Camera { name: name.to_owned(), message };
    let scene = Arc::new(bench.scene(name)?);
    let format = PixelCode::of(site.format).ok_or_else(|| {
        wrong(format!("the GigE Vision twin has no format {:?}; write another `format`", site.format))
    })?;
    if let Some(file) = bench.file().camera.get(name).filter(|f| (f.width_px, f.height_px) != (site.width, site.height))
    {
        return Err(wrong(format!(
            "the instrument expects {} x {} pixels, the simulated bench photographs {} x {}; make them equal",
            site.width, site.height, file.width_px, file.height_px
        )));
    }
    if site.serial.len() > LONGEST_SERIAL {
        let what = "is longer than a GigE Vision camera can tell";
        return Err(wrong(format!("serial number \"{}\" {what}, at most {LONGEST_SERIAL} bytes", site.serial)));
    }
    let sensor = Sensor {
        width: site.width as u32,
        height: site.height as u32,
        shortest_us: site.shortest_s * 1e6,
        longest_us: site.longest_s * 1e6,
        format,
        ..Sensor::default()
    };
    let readout = Duration::try_from_secs_f64(site.readout_s).unwrap_or_default();
    for step in 0..ADDRESSES {
        let address = Ipv4Addr::from(u32::from(first) + step);
        let quick = TwinConfig::quick(address, &site.serial);
        let config = TwinConfig { sensor: sensor.clone(), real_exposure: true, readout, seed, ..quick };
        match GigeTwin::start(config, scene.clone()) {
            Ok(twin) => return Ok(twin),
            Err(error) if error.kind() == io::ErrorKind::AddrInUse => {}
            Err(source) => return Err(ServeError::Address { name: name.to_owned(), address, source }),
        }
    }
    Err(wrong(format!("no loopback address from {first} on is free; end other simulations")))
}
