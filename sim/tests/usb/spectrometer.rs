//! The spectrometer driver against its twins.

use super::{OceanBus, meter_config, meter_of, ocean, ocean_driver, ocean_of};
use goniod_drivers::clock::Clock;
use goniod_drivers::contract::{Spectrometer, Spectrum};
use goniod_drivers::error::ErrorKind;
use goniod_drivers::units::ExposureTime;
use goniod_sim::firmware::usb::UsbFault;
use goniod_sim::firmware::usb::detector::{Exposure, hmi};
use goniod_sim::firmware::usb::oceanoptics::{OceanFault, OceanModel, OceanSpec};
use goniod_sim::firmware::usb::pm100::Pm100Spec;
use std::sync::Arc;
use std::time::Duration;
use tokio::time::Instant;

const MODELS: [OceanModel; 3] = [OceanModel::Usb2000, OceanModel::Usb2000Plus, OceanModel::Usb4000];

/// Active pixels, dark pixels, factor from raw counts to the full scale, full scale: from the data sheets.
fn figures(model: OceanModel) -> (std::ops::Range<usize>, std::ops::Range<usize>, f64, f64) {
    match model {
        OceanModel::Usb2000 => (26..2048, 2..24, 1.0, 4095.0),
        OceanModel::Usb2000Plus => (20..2048, 6..18, 65_535.0 / 62_000.0, 65_535.0),
        OceanModel::Usb4000 => (21..3669, 5..16, 65_535.0 / 62_000.0, 65_535.0),
    }
}

/// What a true exposure means, by the formulas of the sheet, from the twin's memory slots.
fn expected(model: OceanModel, exposure: &Exposure) -> Vec<f64> {
    let (active, dark, factor, full) = figures(model);
    let mean = exposure.raw[dark.clone()].iter().map(|&c| f64::from(c)).sum::<f64>() / dark.len() as f64;
    let (n1, n2) = (format!("{:.4e}", -0.01 / full), format!("{:.4e}", -0.01 / full / full));
    let (n1, n2): (f64, f64) = (n1.parse().unwrap(), n2.parse().unwrap());
    let linear = |&raw: &u16| {
        let v = (f64::from(raw) - mean) * factor;
        v / (1.0 + n1 * v + n2 * v * v)
    };
    exposure.raw[active].iter().map(linear).collect()
}

/// The spectrum is that of a true exposure that began after `call`; gives the exposure.
fn judge(bus: &OceanBus, model: OceanModel, spectrum: &Spectrum, call: Instant) -> Exposure {
    let near = |a: &[f64], b: &[f64]| a.len() == b.len() && a.iter().zip(b).all(|(x, y)| (x - y).abs() < 1e-6);
    let found = bus.with(|twin| twin.exposures().rev().find(|e| near(&expected(model, e), &spectrum.counts)).cloned());
    let exposure = found.expect("the spectrum is none that the device took");
    assert!(exposure.began >= call, "it began {:?} before the call", call - exposure.began);
    assert_eq!(exposure.ended - exposure.began, spectrum.exposure.duration());
    assert!(spectrum.at >= exposure.ended);
    exposure
}

async fn takes_a_true_one(bus: &OceanBus, model: OceanModel, driver: &mut Box<dyn Spectrometer>) {
    let call = Instant::now();
    let spectrum = driver.acquire().await.unwrap();
    judge(bus, model, &spectrum, call);
}

#[tokio::test(start_paused = true)]
async fn every_model_says_who_it_is_and_gives_true_counts_on_true_wavelengths() {
    for (model, name) in MODELS.into_iter().zip(["USB2000", "USB2000+", "USB4000"]) {
        let (bus, mut driver) = ocean_of(OceanSpec::new(model, "USB2G1234"));
        let identity = driver.open().await.unwrap();
        assert_eq!((identity.model.as_str(), identity.serial.as_str()), (name, "USB2G1234"));
        let call = Instant::now();
        let spectrum = driver.acquire().await.unwrap();
        judge(&bus, model, &spectrum, call);
        assert_eq!(spectrum.exposure, ExposureTime(100_000));
        assert_eq!(spectrum.wavelength_nm.len(), spectrum.counts.len());
        // The lamp's lines stand where they are, and as high.
        let scale = figures(model).3 / 4095.0;
        for line in [435.8, 546.1, 578.0] {
            let window = spectrum.wavelength_nm.iter().zip(&spectrum.counts).filter(|(nm, _)| (*nm - line).abs() < 3.0);
            let (at, height) = window.max_by(|a, b| a.1.total_cmp(b.1)).unwrap();
            let truth = 0.1 * scale * hmi()(line, call);
            assert!((at - line).abs() < 0.8 && (height / truth - 1.0).abs() < 0.05, "{at} {line} {height} {truth}");
        }
        assert!(driver.health().await.unwrap().warnings.is_empty());
        driver.make_safe().await.unwrap();
        assert!(!bus.with(|twin| twin.lamp()));
    }
}

#[tokio::test(start_paused = true)]
async fn integration_times_are_in_the_models_unit_limited_and_proven() {
    for (model, shortest, rounded) in [
        (OceanModel::Usb2000, 3000, 12_000),
        (OceanModel::Usb2000Plus, 1000, 12_345),
        (OceanModel::Usb4000, 10, 12_345),
    ] {
        let (bus, mut driver) = ocean(model).await;
        assert_eq!(driver.limits().0, ExposureTime(shortest));
        for outside in [shortest - 1, driver.limits().1.0 + 1] {
            assert_eq!(driver.apply(ExposureTime(outside)).await.unwrap_err().kind, ErrorKind::Refused);
        }
        for (asked, applied) in [(12_345, rounded), (shortest, shortest), (2_000_000, 2_000_000)] {
            assert_eq!(driver.apply(ExposureTime(asked)).await.unwrap(), ExposureTime(applied));
            assert_eq!(bus.with(|twin| twin.time_us()), applied);
            let call = Instant::now();
            let spectrum = driver.acquire().await.unwrap();
            assert_eq!(spectrum.exposure, ExposureTime(applied));
            judge(&bus, model, &spectrum, call);
        }
    }
}

#[tokio::test(start_paused = true)]
async fn a_spectrum_sees_nothing_of_the_light_before_the_call() {
    let dark_from = Instant::now() + Duration::from_secs(5);
    let lamp = hmi();
    let light = Arc::new(move |nm, at| if at < dark_from { lamp(nm, at) } else { 0.0 });
    let (bus, mut driver) = ocean_of(OceanSpec { light, ..OceanSpec::new(OceanModel::Usb2000, "USB2G1234") });
    driver.open().await.unwrap();
    tokio::time::sleep_until(dark_from).await;
    let call = Instant::now();
    let spectrum = driver.acquire().await.unwrap();
    judge(&bus, OceanModel::Usb2000, &spectrum, call);
    assert!(spectrum.counts.iter().all(|c| c.abs() < 20.0));
}

#[tokio::test(start_paused = true)]
async fn saturated_pixels_are_counted() {
    for model in MODELS {
        let (bus, mut driver) = ocean(model).await;
        assert_eq!(driver.acquire().await.unwrap().saturated, 0);
        driver.apply(ExposureTime(1_000_000)).await.unwrap();
        let call = Instant::now();
        let spectrum = driver.acquire().await.unwrap();
        let truth = judge(&bus, model, &spectrum, call);
        let top = if model == OceanModel::Usb2000 { 4095 } else { 62_000 };
        let full = truth.raw.iter().filter(|&&c| c >= top).count();
        assert!(full > 10 && spectrum.saturated == full, "{full} {}", spectrum.saturated);
    }
}

#[tokio::test(start_paused = true)]
async fn every_fault_of_a_spectrum_costs_time_and_no_truth() {
    let faults = [
        UsbFault::Late(Duration::from_millis(300)),
        UsbFault::Late(Duration::from_secs(3)),
        UsbFault::NoReply,
        UsbFault::Cut(0),
        UsbFault::Cut(64),
        UsbFault::Cut(1000),
        UsbFault::Cut(4096),
        UsbFault::Corrupt(0, 0x01),
        UsbFault::Junk(vec![0x69]),
        UsbFault::Junk(vec![0; 100]),
        UsbFault::Previous,
        UsbFault::Duplicate,
        UsbFault::Stall,
        UsbFault::Babble,
    ];
    for model in MODELS {
        for fault in &faults {
            let (bus, mut driver) = ocean(model).await;
            for place in 0..2 {
                bus.with(|twin| {
                    let fault = OceanFault::Spectrum(fault.clone());
                    (0..place).for_each(|_| twin.inject(OceanFault::Spectrum(UsbFault::Pass), Instant::now()));
                    twin.inject(fault, Instant::now());
                });
                takes_a_true_one(&bus, model, &mut driver).await;
                takes_a_true_one(&bus, model, &mut driver).await;
            }
        }
    }
}

#[tokio::test(start_paused = true)]
async fn every_fault_of_a_short_answer_is_asked_again() {
    let faults = [
        UsbFault::Late(Duration::from_millis(700)),
        UsbFault::NoReply,
        UsbFault::Cut(9),
        UsbFault::Corrupt(5, 0x01),
        UsbFault::Junk(vec![5]),
        UsbFault::Previous,
        UsbFault::Duplicate,
        UsbFault::Stall,
        UsbFault::Babble,
    ];
    for fault in faults {
        let (bus, mut driver) = ocean_of(OceanSpec::new(OceanModel::Usb2000, "USB2G1234"));
        bus.with(|twin| {
            for place in [3, 7, 11] {
                (0..place).for_each(|_| twin.inject(OceanFault::Query(UsbFault::Pass), Instant::now()));
                twin.inject(OceanFault::Query(fault.clone()), Instant::now());
            }
        });
        let identity = driver.open().await.unwrap();
        assert_eq!(identity.serial, "USB2G1234");
        takes_a_true_one(&bus, OceanModel::Usb2000, &mut driver).await;
        bus.with(|twin| twin.inject(OceanFault::Query(fault.clone()), Instant::now()));
        assert_eq!(driver.apply(ExposureTime(50_000)).await.unwrap(), ExposureTime(50_000));
        assert_eq!(bus.with(|twin| twin.time_us()), 50_000);
    }
}

#[tokio::test(start_paused = true)]
async fn a_stale_or_dead_detector_is_no_measurement() {
    let (bus, mut driver) = ocean(OceanModel::Usb2000).await;
    takes_a_true_one(&bus, OceanModel::Usb2000, &mut driver).await;
    bus.with(|twin| twin.inject(OceanFault::Stale(2), Instant::now()));
    takes_a_true_one(&bus, OceanModel::Usb2000, &mut driver).await;
    let health = driver.health().await.unwrap();
    assert!(health.warnings.iter().any(|w| w.contains("taken again")), "{health:?}");
    bus.with(|twin| twin.inject(OceanFault::Dead(true), Instant::now()));
    let error = driver.acquire().await.unwrap_err();
    assert!(error.kind == ErrorKind::Garbled && error.message.contains("does not run"), "{error}");
    bus.with(|twin| twin.inject(OceanFault::Dead(false), Instant::now()));
    takes_a_true_one(&bus, OceanModel::Usb2000, &mut driver).await;
}

#[tokio::test(start_paused = true)]
async fn both_orders_of_the_status_and_both_kinds_of_init_are_understood() {
    for (little, leaves) in [(false, true), (true, false), (true, true)] {
        let (bus, mut driver) = ocean_of(OceanSpec::new(OceanModel::Usb2000, "USB2G1234"));
        bus.with(|twin| {
            twin.inject(OceanFault::LittleStatus(little), Instant::now());
            twin.inject(OceanFault::InitLeavesSpectrum(leaves), Instant::now());
        });
        driver.open().await.unwrap();
        assert_eq!(driver.apply(ExposureTime(259_000)).await.unwrap(), ExposureTime(259_000));
        takes_a_true_one(&bus, OceanModel::Usb2000, &mut driver).await;
    }
}

#[tokio::test(start_paused = true)]
async fn a_wrong_unit_or_a_lost_calibration_is_not_opened() {
    let (bus, _) = ocean_of(OceanSpec::new(OceanModel::Usb2000, "USB2G9999"));
    let mut driver = ocean_driver(bus.connector(Clock::system()), "USB2G1234");
    let error = driver.open().await.unwrap_err();
    assert!(error.kind == ErrorKind::WrongDevice && error.message.contains("USB2G9999"), "{error}");
    assert_eq!(driver.acquire().await.unwrap_err().kind, ErrorKind::Lost);
    for (slot, text) in
        [(1, ""), (2, "0.3x"), (3, "\u{ff}\u{ff}"), (1, "-900"), (7, ""), (14, "9"), (6, "0.0"), (0, "")]
    {
        let (bus, mut driver) = ocean_of(OceanSpec::new(OceanModel::Usb2000, "USB2G1234"));
        bus.with(|twin| twin.set_slot(slot, text.as_bytes()));
        let error = driver.open().await.unwrap_err();
        assert_eq!(error.kind, ErrorKind::Broken, "slot {slot} {text:?}: {error}");
    }
    let (meter, _) = meter_of(Pm100Spec::new("P1"), meter_config());
    let mut driver = ocean_driver(meter.connector(Clock::system()), "");
    assert_eq!(driver.open().await.unwrap_err().kind, ErrorKind::WrongDevice);
}

#[tokio::test(start_paused = true)]
async fn a_restart_or_a_pulled_cable_is_a_lost_device_until_it_is_opened_again() {
    for model in MODELS {
        let (bus, mut driver) = ocean(model).await;
        driver.apply(ExposureTime(20_000)).await.unwrap();
        bus.with(|twin| twin.inject(OceanFault::Spectrum(UsbFault::Restart), Instant::now()));
        assert_eq!(driver.acquire().await.unwrap_err().kind, ErrorKind::Lost);
        driver.open().await.unwrap();
        assert_eq!(driver.apply(ExposureTime(500_000)).await.unwrap(), ExposureTime(500_000));
        // Pulled in the middle of a transfer.
        let pulled = bus.clone();
        tokio::spawn(async move {
            tokio::time::sleep(Duration::from_millis(300)).await;
            pulled.unplug_for(Duration::from_secs(2));
        });
        assert_eq!(driver.acquire().await.unwrap_err().kind, ErrorKind::Lost);
        assert_eq!(driver.open().await.unwrap_err().kind, ErrorKind::Lost);
        tokio::time::sleep(Duration::from_secs(3)).await;
        driver.open().await.unwrap();
        takes_a_true_one(&bus, model, &mut driver).await;
    }
}

#[tokio::test(start_paused = true)]
async fn an_acquisition_that_is_dropped_leaves_nothing_for_the_next() {
    for model in MODELS {
        let (bus, mut driver) = ocean(model).await;
        for ms in [1, 40, 99, 110, 150, 190, 205, 260] {
            let dropped = tokio::time::timeout(Duration::from_millis(ms), driver.acquire()).await;
            drop(dropped);
            takes_a_true_one(&bus, model, &mut driver).await;
        }
    }
}
