//! The same drivers on the thread that blocking calls live on, in real time.

use super::{meter_config, meter_driver, ocean_driver};
use goniod_drivers::clock::Clock;
use goniod_drivers::error::ErrorKind;
use goniod_drivers::transport::usb::UsbThread;
use goniod_drivers::units::ExposureTime;
use goniod_sim::firmware::usb::oceanoptics::{OceanModel, OceanSpec, OceanTwin};
use goniod_sim::firmware::usb::pm100::{Pm100Spec, Pm100Twin};
use goniod_sim::front::UsbBus;
use std::time::Duration;
use tokio::time::Instant;

#[tokio::test]
async fn a_meter_behind_the_thread_reads_and_comes_back_after_an_unplug() {
    let bus = UsbBus::new("usb:1313:8078", Pm100Twin::new(Pm100Spec::new("P0001234")));
    let config = goniod_drivers::devices::LightMonitorConfig { average: 1, ..meter_config() };
    let mut driver = meter_driver(UsbThread::new(bus.opener(), Clock::system()), config);
    driver.open().await.unwrap();
    for round in 0..2 {
        for _ in 0..5 {
            let reading = driver.read().await.unwrap();
            assert_eq!(reading.power_w, bus.with(|twin| twin.history().next_back().unwrap()));
        }
        if round == 0 {
            bus.unplug();
            assert_eq!(driver.read().await.unwrap_err().kind, ErrorKind::Lost);
            assert_eq!(driver.open().await.unwrap_err().kind, ErrorKind::Lost);
            bus.plug();
            driver.open().await.unwrap();
        }
    }
}

#[tokio::test]
async fn a_spectrometer_behind_the_thread_measures_and_a_pulled_cable_ends_the_transfer() {
    let bus =
        UsbBus::new("usb:2457:101e", OceanTwin::new(OceanSpec::new(OceanModel::Usb2000Plus, "A1"), Instant::now()));
    let mut driver = ocean_driver(UsbThread::new(bus.opener(), Clock::system()), "A1");
    driver.open().await.unwrap();
    driver.apply(ExposureTime(5000)).await.unwrap();
    for _ in 0..3 {
        assert_eq!(driver.acquire().await.unwrap().exposure, ExposureTime(5000));
    }
    driver.apply(ExposureTime(2_000_000)).await.unwrap();
    let pulled = bus.clone();
    let pull = async {
        tokio::time::sleep(Duration::from_millis(200)).await;
        pulled.unplug();
    };
    let (lost, ()) = tokio::join!(driver.acquire(), pull);
    assert_eq!(lost.unwrap_err().kind, ErrorKind::Lost);
    bus.plug();
    driver.open().await.unwrap();
    driver.apply(ExposureTime(5000)).await.unwrap();
    driver.acquire().await.unwrap();
}
