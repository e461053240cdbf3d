//! USB instruments on libusb: spectrometer and power meter behind `vhci-hcd`, with their production drivers.

use crate::ensure;
use crate::report::{Outcome, Report};
use crate::vhci;
use goniod_drivers::clock::Clock;
use goniod_drivers::contract::{LightMonitor, Spectrometer};
use goniod_drivers::devices::{LightMonitorConfig, SpectrometerConfig};
use goniod_drivers::error::ErrorKind;
use goniod_drivers::table;
use goniod_drivers::transport::usb::{LibUsb, UsbConnector, UsbError, UsbThread};
use goniod_drivers::units::{ExposureTime, Nanometres};
use goniod_sim::firmware::usb::UsbFault;
use goniod_sim::firmware::usb::oceanoptics::{OceanFault, OceanModel, OceanSpec, OceanTwin};
use goniod_sim::firmware::usb::pm100::{Pm100Fault, Pm100Spec, Pm100Twin};
use goniod_sim::front::usb::UsbTwin;
use goniod_sim::front::usbip::UsbIpServer;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::time::Instant;

const LIMIT: Duration = Duration::from_secs(200);
/// Limit for a device to be enumerated or to go.
const ENUMERATION: Duration = Duration::from_secs(20);
const BUS: &str = "1-1";
const METER: &str = "usb:1313:8078:P0001234";
const SPECTRA: usize = 200;
const READINGS: usize = 200;

type Error = Box<dyn std::error::Error + Send + Sync>;

/// A twin on its server, plugged into this machine.
struct Plugged<T> {
    server: UsbIpServer,
    twin: Arc<Mutex<T>>,
    port: String,
    _attached: vhci::Attached,
}

/// Runs the subject.
pub async fn run(report: &mut Report) {
    report.check("spectra-of-three-models-are-exact", LIMIT, spectra()).await;
    report.check("waits-and-halts-of-the-bus-are-honest", LIMIT, waits_and_halts()).await;
    report.check("a-spectrometer-is-pulled-in-mid-transfer", LIMIT, pulled()).await;
    report.check("readings-of-a-meter-are-exact", LIMIT, readings()).await;
    report.check("a-meter-restarts", LIMIT, restart()).await;
}

// === impl Plugged ===

impl<T: UsbTwin> Plugged<T> {
    async fn new(twin: T, port: &str) -> Result<Plugged<T>, Error> {
        let server = UsbIpServer::start("127.0.0.1:0")?;
        let twin = Arc::new(Mutex::new(twin));
        server.plug(BUS, Arc::clone(&twin));
        let attached = vhci::attach(server.address(), BUS)?;
        let plugged = Plugged { server, twin, port: port.to_owned(), _attached: attached };
        plugged.found(true).await?;
        Ok(plugged)
    }

    fn twin(&self) -> MutexGuard<'_, T> {
        self.twin.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn connector(&self) -> Result<UsbThread, Error> {
        Ok(UsbThread::new(LibUsb::new(self.port.parse()?), Clock::system()))
    }

    /// Waits until libusb finds the device, or finds it no more.
    async fn found(&self, wanted: bool) -> Result<(), Error> {
        let clock = Clock::system();
        while self.connector()?.connect().await.is_ok() != wanted {
            ensure!(clock.elapsed() < ENUMERATION, "{} did not {}", self.port, if wanted { "come" } else { "go" });
            clock.sleep(Duration::from_millis(50)).await;
        }
        Ok(())
    }

    /// Puts a pulled device back.
    async fn back(&mut self) -> Result<(), Error> {
        self.server.plug(BUS, Arc::clone(&self.twin));
        self._attached = vhci::attach(self.server.address(), BUS)?;
        self.found(true).await
    }
}

async fn spectrometer(model: OceanModel) -> Result<(Plugged<OceanTwin>, Box<dyn Spectrometer>), Error> {
    let port = match model {
        OceanModel::Usb2000 => "usb:2457:1002",
        OceanModel::Usb2000Plus => "usb:2457:101e",
        OceanModel::Usb4000 => "usb:2457:1022",
    };
    let plugged = Plugged::new(OceanTwin::new(OceanSpec::new(model, "USB2G1234"), Instant::now()), port).await?;
    let config = SpectrometerConfig { name: "spectrometer".into(), serial: "USB2G1234".into() };
    let driver = table::spectrometer("oceanoptics-usb", Box::new(plugged.connector()?), config, Clock::system())?;
    Ok((plugged, driver))
}

/// Dark pixels, first and one past the last active pixel, factor to the full scale: from the data sheets.
fn figures(model: OceanModel) -> (std::ops::Range<usize>, std::ops::Range<usize>, f64) {
    match model {
        OceanModel::Usb2000 => (2..24, 26..2048, 1.0),
        OceanModel::Usb2000Plus => (6..18, 20..2048, 65_535.0 / 62_000.0),
        OceanModel::Usb4000 => (5..16, 21..3669, 65_535.0 / 62_000.0),
    }
}

/// The spectrum is one that the twin took after `call`, pixel by pixel: dark-free counts that the non-linearity (at most
/// two per cent) has moved.
fn judge(twin: &OceanTwin, model: OceanModel, counts: &[f64], call: Instant) -> Result<(), Error> {
    let (dark, active, factor) = figures(model);
    let fits = |raw: &[u16]| {
        let level = raw[dark.clone()].iter().map(|&c| f64::from(c)).sum::<f64>() / dark.len() as f64;
        let value = |&c: &u16| (f64::from(c) - level) * factor;
        raw[active.clone()].len() == counts.len()
            && raw[active.clone()].iter().map(value).zip(counts).all(|(v, c)| (c - v).abs() <= 0.021 * v.abs() + 1e-6)
    };
    let exposure = twin.exposures().rev().find(|e| fits(&e.raw)).ok_or("a spectrum is none that the device took")?;
    ensure!(exposure.began >= call, "a spectrum began {:?} before its call", call - exposure.began);
    Ok(())
}

async fn spectra() -> Outcome {
    let mut text = Vec::new();
    for (model, number) in [(OceanModel::Usb2000, SPECTRA), (OceanModel::Usb2000Plus, 20), (OceanModel::Usb4000, 20)] {
        let (plugged, mut driver) = spectrometer(model).await?;
        let identity = driver.open().await?;
        ensure!(identity.serial == "USB2G1234", "{identity:?}");
        driver.apply(ExposureTime(5000)).await?;
        for _ in 0..number {
            let call = Instant::now();
            let spectrum = driver.acquire().await?;
            judge(&plugged.twin(), model, &spectrum.counts, call)?;
        }
        text.push(format!("{} {number} of {number}", identity.model));
        plugged.server.unplug(BUS);
        plugged.found(false).await?;
    }
    Ok(text.join(", "))
}

async fn waits_and_halts() -> Outcome {
    let (plugged, mut driver) = spectrometer(OceanModel::Usb2000).await?;
    let wait = Duration::from_millis(300);
    let waited = {
        let mut link = plugged.connector()?.connect().await?;
        let begin = Instant::now();
        let nothing = link.read(0x87, 64, wait).await;
        ensure!(nothing == Err(UsbError::Timeout), "{nothing:?}");
        ensure!(begin.elapsed() >= wait, "it gave up after {:?}", begin.elapsed());
        let waited = begin.elapsed();
        plugged.twin().inject(OceanFault::Query(UsbFault::Stall), Instant::now());
        link.send(0x02, &[0x05, 0], wait).await.map_err(|e| format!("{e:?}"))?;
        for _ in 0..2 {
            let halted = link.read(0x87, 64, Duration::from_secs(2)).await;
            ensure!(halted == Err(UsbError::Stall), "{halted:?}");
        }
        link.clear_halt(0x87).await.map_err(|e| format!("{e:?}"))?;
        link.send(0x02, &[0x05, 0], wait).await.map_err(|e| format!("{e:?}"))?;
        let slot = link.read(0x87, 64, Duration::from_secs(2)).await.map_err(|e| format!("{e:?}"))?;
        ensure!(slot.get(2..11) == Some(b"USB2G1234"), "{slot:?}");
        waited
    };
    driver.open().await?;
    driver.apply(ExposureTime(10_000)).await?;
    for fault in [UsbFault::Stall, UsbFault::Cut(1000), UsbFault::Duplicate, UsbFault::Corrupt(0, 1), UsbFault::NoReply]
    {
        plugged.twin().inject(OceanFault::Spectrum(fault), Instant::now());
        let call = Instant::now();
        let spectrum = driver.acquire().await?;
        judge(&plugged.twin(), OceanModel::Usb2000, &spectrum.counts, call)?;
    }
    Ok(format!("a wait of 300 ms lasted {} ms; five kinds of fault taken again", waited.as_millis()))
}

async fn pulled() -> Outcome {
    let (mut plugged, mut driver) = spectrometer(OceanModel::Usb2000).await?;
    driver.open().await?;
    let mut said = Vec::new();
    for _ in 0..2 {
        driver.apply(ExposureTime(3_000_000)).await?;
        let pull = async {
            Clock::system().sleep(Duration::from_millis(700)).await;
            plugged.server.unplug(BUS)
        };
        let (result, _) = tokio::join!(driver.acquire(), pull);
        let error = result.err().ok_or("a spectrum ended well without its device")?;
        ensure!(error.kind == ErrorKind::Lost, "{:?}: {error}", error.kind);
        said.push(error.message);
        plugged.found(false).await?;
        let missing = driver.open().await.err().ok_or("opened without a device")?;
        ensure!(missing.kind == ErrorKind::Lost, "{:?}: {missing}", missing.kind);
        plugged.back().await?;
        driver.open().await?;
        driver.apply(ExposureTime(10_000)).await?;
        let call = Instant::now();
        let spectrum = driver.acquire().await?;
        judge(&plugged.twin(), OceanModel::Usb2000, &spectrum.counts, call)?;
    }
    said.dedup();
    Ok(format!("pulled twice in mid-transfer: {said:?}"))
}

async fn meter() -> Result<(Plugged<Pm100Twin>, Box<dyn LightMonitor>), Error> {
    let plugged = Plugged::new(Pm100Twin::new(Pm100Spec::new("P0001234")), METER).await?;
    let config = LightMonitorConfig {
        name: "light_monitor".into(),
        serial: "P0001234+12345".into(),
        wavelength: Nanometres(550.0),
        average: 3,
    };
    let driver = table::usb_light_monitor("thorlabs-pm100", Box::new(plugged.connector()?), config, Clock::system())?;
    Ok((plugged, driver))
}

async fn exact(plugged: &Plugged<Pm100Twin>, driver: &mut Box<dyn LightMonitor>) -> Result<f64, Error> {
    let said = driver.read().await?.power_w;
    let truth = plugged.twin().history().next_back().ok_or("nothing was measured")?;
    ensure!(said == truth, "the driver says {said}, the meter measured {truth}");
    Ok(said)
}

async fn readings() -> Outcome {
    let (plugged, mut driver) = meter().await?;
    let identity = driver.open().await?;
    for n in 0..READINGS {
        if n % 20 == 19 {
            let faults =
                [UsbFault::Stall, UsbFault::Duplicate, UsbFault::Previous, UsbFault::Cut(4), UsbFault::NoReply];
            let fault = faults.get(n / 20 % faults.len()).cloned().unwrap_or(UsbFault::Pass);
            plugged.twin().inject(Pm100Fault::Wire(fault));
        }
        exact(&plugged, &mut driver).await?;
    }
    Ok(format!("{} {}: {READINGS} of {READINGS}, ten of them after a fault", identity.model, identity.serial))
}

async fn restart() -> Outcome {
    let (mut plugged, mut driver) = meter().await?;
    driver.open().await?;
    exact(&plugged, &mut driver).await?;
    plugged.twin().inject(Pm100Fault::Restart);
    plugged.server.unplug(BUS);
    let error = driver.read().await.err().ok_or("a reading came from a device that is gone")?;
    ensure!(error.kind == ErrorKind::Lost, "{:?}: {error}", error.kind);
    plugged.found(false).await?;
    plugged.back().await?;
    driver.open().await?;
    let power = exact(&plugged, &mut driver).await?;
    Ok(format!("lost, found again, {power:e} W"))
}
