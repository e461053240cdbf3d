//! A simulated bench served to other processes: from an instrument file to a running bench and the instrument file by
//! which any program reaches it as it would reach the hardware.

use super::hardware::camera_config;
use super::{BenchError, simulated};
use crate::config::instrument::{Camera, Instrument};
use crate::front::cli::exit::Exit;
use goniod_drivers::clock::Clock;
use goniod_drivers::table::{self, Make};
use goniod_drivers::transport::usb::UsbAddress;
use goniod_sim::served::usb::{meter_model, spectrometer_model};
use goniod_sim::served::{Line, ServeError, Served, Site, UsbSite};
use goniod_sim::truth::error::SimError;
use std::collections::BTreeMap;
use std::io;
use std::path::{Path, PathBuf};

/// Name of the instrument file in the folder.
pub const INSTRUMENT: &str = "instrument.toml";
/// What a busy machine may need for a frame beyond exposure and read-out, seconds.
const MARGIN_S: f64 = 5.0;
/// Ids of the meter and the spectrometer where the instrument file names none.
const USUAL_METER: (u16, u16) = (0x1313, 0x8078);
const USUAL_SPECTROMETER: (u16, u16) = (0x2457, 0x101e);
/// Serial number of a meter where the instrument file names none.
const USUAL_SERIAL: &str = "P0001234";

/// What is to be served.
#[derive(Debug, Clone)]
pub struct Request<'a> {
    /// Folder of the instrument file, base of the paths in it.
    pub base: &'a Path,
    /// Folder for ports, socket and instrument file.
    pub folder: &'a Path,
    /// Sample in the holder instead of clear glazing.
    pub sample: Option<&'a Path>,
    /// Seed instead of the instrument's.
    pub seed: Option<u64>,
}

/// A bench that other processes use until this is dropped.
pub struct Standing {
    /// Its instrument file.
    pub instrument: PathBuf,
    served: Served,
}

// === impl Standing ===

impl Standing {
    /// Address of each camera.
    pub fn cameras(&self) -> &BTreeMap<String, String> {
        self.served.addresses()
    }

    /// Names of the serial ports.
    pub fn ports(&self) -> Vec<&Path> {
        self.served.ports()
    }

    /// What an operator must do for USB devices, one line each.
    pub fn usb_hints(&self) -> Vec<String> {
        self.served.usb_hints()
    }
}

/// Serves the simulated bench of an instrument, whatever ports the file names. Needs a tokio runtime in real time.
///
/// # Errors
/// [`BenchError`]: no simulation table, wrong files of the bench, a folder, port or address that cannot be had.
pub fn serve(instrument: &Instrument, request: &Request<'_>, clock: Clock) -> Result<Standing, BenchError> {
    let simulation = instrument.simulation.as_ref().ok_or(BenchError::NoSimulation)?;
    let description = request.base.join(&simulation.bench);
    let usual = description.with_file_name("samples").join("clear_glazing.toml");
    let seed = request.seed.unwrap_or(simulation.seed);
    let (twins, bench) = simulated::parts(instrument, &description, request.sample.unwrap_or(&usual), seed, clock)?;
    let folder = absolute(request.folder).map_err(|e| failed(request.folder, e))?;
    let site = site(instrument, &folder, seed)?;
    let served = Served::start(&site, twins, &bench, clock).map_err(BenchError::Served)?;
    let path = folder.join(INSTRUMENT);
    let text = document(instrument, request.base, &site, served.addresses()).map_err(|e| failed(&path, e))?;
    crate::archive::write_atomic(&path, text.as_bytes()).map_err(|e| failed(&path, io::Error::other(e)))?;
    Ok(Standing { instrument: path, served })
}

/// The exit code of a bench that cannot be served.
pub fn exit_of(e: &BenchError) -> Exit {
    match e {
        BenchError::Served(ServeError::InUse { .. }) => Exit::Refused,
        BenchError::Served(ServeError::Folder { .. }) => Exit::Storage,
        BenchError::Served(ServeError::Address { .. } | ServeError::Usb(_)) => Exit::Failed,
        _ => Exit::BadInput,
    }
}

fn failed(path: &Path, source: io::Error) -> BenchError {
    BenchError::Served(ServeError::Folder { path: path.to_owned(), source })
}

/// The folder's full path, however the command was given it.
fn absolute(folder: &Path) -> io::Result<PathBuf> {
    std::fs::create_dir_all(folder)?;
    std::fs::canonicalize(folder)
}

/// What stands on the bench of this instrument.
fn site(i: &Instrument, folder: &Path, seed: u64) -> Result<Site, BenchError> {
    let mut lines = vec![Line::Holder, Line::FilterWheel, Line::Shutter];
    lines.extend(i.monochromator.as_ref().map(|_| Line::Monochromator));
    let mut meter = None;
    if let Some(monitor) = &i.light_monitor {
        match (monitor.driver.as_str(), table::lookup(&monitor.driver)?.make) {
            (_, Make::UsbLightMonitor(_)) => {
                meter = Some(usb(&monitor.port, monitor.serial.as_deref(), USUAL_METER));
            }
            ("newport-1830c", _) => lines.push(Line::LightMonitor),
            (other, _) => return Err(no_twin(other, "newport-1830c, thorlabs-pm100")),
        }
    }
    if meter.as_ref().is_some_and(|site| meter_model(site.product).is_none()) {
        return Err(no_twin("light monitor with these USB ids", "1313:8078, 1313:8076, 1313:8072"));
    }
    let spectrometer = i.spectrometer.as_ref().map(|s| usb(&s.port, Some(&s.serial), USUAL_SPECTROMETER));
    if spectrometer.as_ref().is_some_and(|site| spectrometer_model(site.product).is_none()) {
        return Err(no_twin("spectrometer with these USB ids", "2457:1002, 2457:101e, 2457:1022"));
    }
    let cameras = i.camera.iter().map(|(name, camera)| (name.clone(), camera_config(name, camera))).collect();
    Ok(Site { folder: folder.to_owned(), lines, cameras, meter, spectrometer, seed })
}

fn no_twin(name: &str, known: &str) -> BenchError {
    let (name, known) = (name.to_owned(), known.to_owned());
    BenchError::Simulation(SimError::Unknown { what: "device in software for the driver", name, known })
}

/// The device that the port names; the usual one where the port is no USB address.
fn usb(port: &str, serial: Option<&str>, (_, product): (u16, u16)) -> UsbSite {
    let address: Option<UsbAddress> = port.parse().ok();
    let named = address.as_ref().and_then(|a| a.serial.as_deref());
    let serial = serial.or(named).unwrap_or(USUAL_SERIAL).to_owned();
    UsbSite { product: address.map_or(product, |a| a.product), serial }
}

/// The instrument file of a bench that is served.
fn document(i: &Instrument, base: &Path, site: &Site, addresses: &BTreeMap<String, String>) -> io::Result<String> {
    let mut served = i.clone();
    paths(&mut served, base);
    ports(&mut served, site);
    for (name, camera) in &mut served.camera {
        through_gige(camera, addresses.get(name).map_or("", String::as_str));
    }
    let text = toml::to_string(&served).map_err(io::Error::other)?;
    let mut out =
        "# The bench that `goniod simulate` serves from this folder. The drivers are those of the instrument it was\n\
                   # made from; only ports, cameras and paths differ.\n"
            .to_owned();
    for line in text.lines() {
        let camera = i.camera.iter().find(|(name, _)| line == format!("[camera.{name}]"));
        if let Some((_, camera)) = camera {
            out += &comment(camera);
        }
        out += line;
        out.push('\n');
    }
    Ok(out)
}

/// Why the camera's tables are not those of the instrument file.
fn comment(camera: &Camera) -> String {
    let why = match camera.driver.as_str() {
        "v4l2" | "sim-ccd" => "A camera behind V4L2 needs a kernel module (v4l2loopback), so this one is offered",
        _ => "This one is offered",
    };
    format!("# {why} as a GigE Vision camera\n# with a software trigger on a loopback address.\n")
}

fn ports(i: &mut Instrument, site: &Site) {
    i.simulation = None;
    let port = |line: Line| site.folder.join(line.name()).to_string_lossy().into_owned();
    i.holder.port = port(Line::Holder);
    i.filter_wheel.port = port(Line::FilterWheel);
    i.shutter.port = port(Line::Shutter);
    i.monochromator.iter_mut().for_each(|m| m.port = port(Line::Monochromator));
    if let Some(monitor) = &mut i.light_monitor {
        monitor.port = match &site.meter {
            Some(usb) => format!("usb:{:04x}:{:04x}:{}", USUAL_METER.0, usb.product, usb.serial),
            None => port(Line::LightMonitor),
        };
    }
    if let (Some(spectrometer), Some(usb)) = (&mut i.spectrometer, &site.spectrometer) {
        // Its serial number is in its memory, not in the descriptor that the address means.
        spectrometer.port = format!("usb:{:04x}:{:04x}", USUAL_SPECTROMETER.0, usb.product);
    }
}

/// The camera as its twin on loopback is.
fn through_gige(camera: &mut Camera, address: &str) {
    camera.driver = "aravis".to_owned();
    camera.port = address.to_owned();
    camera.v4l2 = None;
    let mut table = camera.aravis.clone().unwrap_or_default();
    table.trigger = None;
    table.frame_rate_hz = None;
    table.packing = None;
    table.cooler = None;
    table.margin_s = Some(table.margin_s.unwrap_or(0.0).max(MARGIN_S));
    camera.aravis = Some(table);
    // With a software trigger the twin has no old frames and never restarts its stream.
    camera.discard_frames = 0;
    camera.restart_s = None;
}

/// Paths that say the same from any folder.
fn paths(i: &mut Instrument, base: &Path) {
    let full = |path: &mut PathBuf| {
        let joined = base.join(&*path);
        *path = std::fs::canonicalize(&joined).or_else(|_| std::path::absolute(&joined)).unwrap_or(joined);
    };
    full(&mut i.lamp.spectrum);
    full(&mut i.filter_wheel.glasses);
    full(&mut i.filter_wheel.glass_parameters);
    full(&mut i.optics.mirror_reflectance);
    i.camera.values_mut().for_each(|camera| full(&mut camera.calibration));
    let references = [&mut i.reference.reflection, &mut i.reference.transmission];
    references.into_iter().flatten().for_each(|reference| full(&mut reference.spectrum));
}
