//! The PM100 driver against the meter's twin.

use super::{MeterBus, meter, meter_config, meter_driver, meter_of, ocean_of};
use goniod_drivers::clock::Clock;
use goniod_drivers::contract::LightMonitor;
use goniod_drivers::devices::LightMonitorConfig;
use goniod_drivers::error::ErrorKind;
use goniod_drivers::units::Nanometres;
use goniod_sim::firmware::usb::UsbFault;
use goniod_sim::firmware::usb::oceanoptics::{OceanModel, OceanSpec};
use goniod_sim::firmware::usb::pm100::{Pm100Fault, Pm100Model, Pm100Spec, responsivity};
use goniod_sim::firmware::usb::tmc::FrameFault;
use std::sync::Arc;
use std::time::Duration;

fn truth(bus: &MeterBus) -> f64 {
    bus.with(|twin| twin.history().next_back().unwrap())
}

async fn reads_the_truth(bus: &MeterBus, driver: &mut Box<dyn LightMonitor>) {
    let reading = driver.read().await.unwrap();
    assert_eq!(reading.power_w, truth(bus));
    assert!((reading.power_w - 1e-3).abs() < 1e-5 && !reading.saturated, "{reading:?}");
}

#[tokio::test(start_paused = true)]
async fn it_says_who_it_is_and_reads_what_the_head_sees() {
    let (bus, mut driver) = meter_of(Pm100Spec::new("P0001234"), meter_config());
    let identity = driver.open().await.unwrap();
    assert_eq!(identity.model, "PM100D with S120VC");
    assert_eq!((identity.serial.as_str(), identity.firmware.as_str()), ("P0001234+12345", "2.4.0"));
    for _ in 0..20 {
        reads_the_truth(&bus, &mut driver).await;
    }
    assert_eq!(driver.health().await.unwrap().warnings, Vec::<String>::new());
    driver.make_safe().await.unwrap();
}

#[tokio::test(start_paused = true)]
async fn the_wavelength_is_set_read_back_and_limited() {
    let (bus, mut driver) = meter().await;
    assert_eq!(driver.apply(Nanometres(600.0)).await.unwrap(), Nanometres(600.0));
    assert_eq!(bus.with(|twin| twin.wavelength()), 600.0);
    let reading = driver.read().await.unwrap();
    assert_eq!(reading.wavelength, Nanometres(600.0));
    let expected = 1e-3 * responsivity(550.0) / responsivity(600.0);
    assert!((reading.power_w / expected - 1.0).abs() < 1e-3);
    for (outside, allowed) in [
        (100.0, "200 to 1100 nm"),
        (1700.0, "200 to 1100 nm"),
        (f64::NAN, "100 to 30000 nm"),
        (31_000.0, "100 to 30000 nm"),
    ] {
        let error = driver.apply(Nanometres(outside)).await.unwrap_err();
        assert_eq!(error.kind, ErrorKind::Refused);
        assert!(error.message.contains(allowed), "{error}");
    }
    assert_eq!(driver.read().await.unwrap().wavelength, Nanometres(600.0));
}

#[tokio::test(start_paused = true)]
async fn meter_head_or_both_may_be_named_and_no_other() {
    for (serial, fits) in [
        ("P0001234", true),
        ("12345", true),
        ("P0001234+12345", true),
        ("", true),
        ("P0009999", false),
        ("1234", false),
    ] {
        let config = LightMonitorConfig { serial: serial.into(), ..meter_config() };
        let (_bus, mut driver) = meter_of(Pm100Spec::new("P0001234"), config);
        match driver.open().await {
            Ok(_) => assert!(fits, "{serial}"),
            Err(error) => {
                assert!(!fits && error.kind == ErrorKind::WrongDevice, "{error}");
                assert!(error.message.contains("P0001234+12345"), "{error}");
            }
        }
        assert_eq!(driver.read().await.is_ok(), fits);
    }
}

#[tokio::test(start_paused = true)]
async fn all_models_are_known_and_other_devices_are_not() {
    for model in [Pm100Model::Pm100D, Pm100Model::Pm100A, Pm100Model::Pm100Usb] {
        let (_bus, mut driver) = meter_of(Pm100Spec { model, ..Pm100Spec::new("P0001234") }, meter_config());
        driver.open().await.unwrap();
    }
    let (bus, _) = ocean_of(OceanSpec::new(OceanModel::Usb2000, "X"));
    let mut driver = meter_driver(bus.connector(Clock::system()), meter_config());
    assert_eq!(driver.open().await.unwrap_err().kind, ErrorKind::WrongDevice);
}

#[tokio::test(start_paused = true)]
async fn light_beyond_the_range_is_marked_and_the_range_is_chosen_anew() {
    let (bus, mut driver) = meter().await;
    bus.with(|twin| twin.set_power(Arc::new(|_| 8e-3)));
    assert!(driver.read().await.unwrap().saturated);
    let reading = driver.read().await.unwrap();
    assert!(!reading.saturated && (reading.power_w - 8e-3).abs() < 1e-4, "{reading:?}");
    // Less light in the same range is read as it is, without a sample of a changing range.
    bus.with(|twin| twin.set_power(Arc::new(|_| 1e-6)));
    for _ in 0..5 {
        assert!((driver.read().await.unwrap().power_w - 1e-6).abs() < 1e-8);
    }
}

#[tokio::test(start_paused = true)]
async fn a_missing_or_changed_head_is_noticed_at_the_next_reading() {
    let (bus, mut driver) = meter().await;
    bus.with(|twin| twin.inject(Pm100Fault::Head(None)));
    let error = driver.read().await.unwrap_err();
    assert_eq!(error.kind, ErrorKind::Broken);
    assert!(error.message.contains("plug the head in"), "{error}");
    bus.with(|twin| twin.inject(Pm100Fault::Head(Some("S121C,777,01-Jan-2020,1,1,33".into()))));
    assert_eq!(driver.read().await.unwrap_err().kind, ErrorKind::WrongDevice);
    assert_eq!(driver.health().await.unwrap_err().kind, ErrorKind::WrongDevice);
    bus.with(|twin| twin.inject(Pm100Fault::Head(Some("S120VC,12345,10-Jan-2010,1,1,33".into()))));
    reads_the_truth(&bus, &mut driver).await;
    bus.with(|twin| twin.inject(Pm100Fault::Head(Some("ES111C,5,01-Jan-2020,2,1,2".into()))));
    assert_eq!(driver.open().await.unwrap_err().kind, ErrorKind::WrongDevice);
}

#[tokio::test(start_paused = true)]
async fn a_wavelength_turned_by_hand_is_noticed() {
    let (bus, mut driver) = meter().await;
    bus.with(|twin| twin.inject(Pm100Fault::WavelengthByHand(800)));
    let error = driver.read().await.unwrap_err();
    assert_eq!(error.kind, ErrorKind::Broken);
    assert!(error.message.contains("800 nm"), "{error}");
    driver.open().await.unwrap();
    reads_the_truth(&bus, &mut driver).await;
}

#[tokio::test(start_paused = true)]
async fn every_fault_of_an_answer_costs_time_and_no_truth() {
    let faults = [
        UsbFault::Late(Duration::from_millis(700)),
        UsbFault::Late(Duration::from_secs(5)),
        UsbFault::NoReply,
        UsbFault::Cut(0),
        UsbFault::Cut(5),
        UsbFault::Corrupt(3, 0x01),
        UsbFault::Corrupt(0, 0x80),
        UsbFault::Junk(b"5.000000E-04\n".to_vec()),
        UsbFault::Previous,
        UsbFault::Duplicate,
        UsbFault::Stall,
        UsbFault::Babble,
    ];
    for fault in faults {
        let (bus, mut driver) = meter().await;
        for place in 0..5 {
            bus.with(|twin| {
                (0..place).for_each(|_| twin.inject(Pm100Fault::Wire(UsbFault::Pass)));
                twin.inject(Pm100Fault::Wire(fault.clone()));
            });
            for _ in 0..3 {
                reads_the_truth(&bus, &mut driver).await;
            }
        }
    }
    for fault in [FrameFault::Tag, FrameFault::NoEnd] {
        let (bus, mut driver) = meter().await;
        bus.with(|twin| twin.inject(Pm100Fault::Frame(fault)));
        reads_the_truth(&bus, &mut driver).await;
        assert!(driver.health().await.unwrap().warnings.iter().any(|w| w.contains("out of step")));
    }
}

#[tokio::test(start_paused = true)]
async fn stale_answers_from_an_earlier_program_are_never_taken() {
    let (bus, mut driver) = meter().await;
    for _ in 0..3 {
        // Three answers too many, so that the order of the next ones fits again.
        bus.with(|twin| {
            let junk = b"7.000000E-04\n".to_vec();
            (0..4).for_each(|_| twin.inject(Pm100Fault::Wire(UsbFault::Junk(junk.clone()))));
        });
        for _ in 0..4 {
            reads_the_truth(&bus, &mut driver).await;
        }
    }
}

#[tokio::test(start_paused = true)]
async fn a_restart_or_a_pulled_cable_is_a_lost_device_until_it_is_opened_again() {
    let (bus, mut driver) = meter().await;
    bus.with(|twin| twin.inject(Pm100Fault::Wire(UsbFault::Restart)));
    assert_eq!(driver.read().await.unwrap_err().kind, ErrorKind::Lost);
    assert_eq!(driver.read().await.unwrap_err().kind, ErrorKind::Lost);
    driver.open().await.unwrap();
    reads_the_truth(&bus, &mut driver).await;
    bus.unplug();
    assert_eq!(driver.read().await.unwrap_err().kind, ErrorKind::Lost);
    let error = driver.open().await.unwrap_err();
    assert_eq!(error.kind, ErrorKind::Lost);
    assert!(error.message.contains("plug it in"), "{error}");
    bus.plug();
    driver.open().await.unwrap();
    reads_the_truth(&bus, &mut driver).await;
}

#[tokio::test(start_paused = true)]
async fn a_reading_that_is_dropped_leaves_nothing_for_the_next() {
    let (bus, mut driver) = meter().await;
    for ms in [1, 20, 60, 93, 95, 97, 99, 101, 150] {
        let dropped = tokio::time::timeout(Duration::from_millis(ms), driver.read()).await;
        drop(dropped);
        reads_the_truth(&bus, &mut driver).await;
    }
}
