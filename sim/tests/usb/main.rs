//! The USB drivers against their twins: worked examples of the sheets, every fault, noise, and the thread for blocking calls.
#![allow(clippy::unwrap_used, clippy::expect_used)]

mod meter;
mod meter_noise;
mod raw;
mod spectrometer;
mod spectrometer_noise;
mod thread;

use goniod_drivers::clock::Clock;
use goniod_drivers::contract::{LightMonitor, Spectrometer};
use goniod_drivers::devices::{LightMonitorConfig, SpectrometerConfig};
use goniod_drivers::table;
use goniod_drivers::transport::UsbConnector;
use goniod_drivers::units::Nanometres;
use goniod_sim::firmware::usb::oceanoptics::{OceanModel, OceanSpec, OceanTwin};
use goniod_sim::firmware::usb::pm100::{Pm100Spec, Pm100Twin};
use goniod_sim::front::UsbBus;
use tokio::time::Instant;

type MeterBus = UsbBus<Pm100Twin>;
type OceanBus = UsbBus<OceanTwin>;

fn meter_config() -> LightMonitorConfig {
    LightMonitorConfig {
        name: "light_monitor".into(),
        serial: "P0001234".into(),
        wavelength: Nanometres(550.0),
        average: 30,
    }
}

fn meter_driver(connector: impl UsbConnector + 'static, config: LightMonitorConfig) -> Box<dyn LightMonitor> {
    table::usb_light_monitor("thorlabs-pm100", Box::new(connector), config, Clock::system()).unwrap()
}

fn meter_of(spec: Pm100Spec, config: LightMonitorConfig) -> (MeterBus, Box<dyn LightMonitor>) {
    let bus = UsbBus::new("usb:1313:8078:P0001234", Pm100Twin::new(spec));
    let driver = meter_driver(bus.connector(Clock::system()), config);
    (bus, driver)
}

/// A meter in steady light of 1 mW, opened.
async fn meter() -> (MeterBus, Box<dyn LightMonitor>) {
    let (bus, mut driver) = meter_of(Pm100Spec::new("P0001234"), meter_config());
    driver.open().await.unwrap();
    (bus, driver)
}

fn ocean_driver(connector: impl UsbConnector + 'static, serial: &str) -> Box<dyn Spectrometer> {
    let config = SpectrometerConfig { name: "spectrometer".into(), serial: serial.into() };
    table::spectrometer("oceanoptics-usb", Box::new(connector), config, Clock::system()).unwrap()
}

fn ocean_of(spec: OceanSpec) -> (OceanBus, Box<dyn Spectrometer>) {
    let bus = UsbBus::new("usb:2457:1002", OceanTwin::new(spec, Instant::now()));
    let driver = ocean_driver(bus.connector(Clock::system()), "USB2G1234");
    (bus, driver)
}

/// A spectrometer in the light of the lamp, opened.
async fn ocean(model: OceanModel) -> (OceanBus, Box<dyn Spectrometer>) {
    let (bus, mut driver) = ocean_of(OceanSpec::new(model, "USB2G1234"));
    driver.open().await.unwrap();
    (bus, driver)
}
