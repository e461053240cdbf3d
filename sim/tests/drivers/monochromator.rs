//! The CM110 driver against the monochromator's twin.

use super::{Bench, bench};
use goniod_drivers::clock::Clock;
use goniod_drivers::contract::Identity;
use goniod_drivers::error::ErrorKind;
use goniod_drivers::transport::{Connector, Link};
use goniod_drivers::units::Nanometres;
use goniod_sim::firmware::WireFault;
use goniod_sim::firmware::cm110::MonochromatorFault;
use goniod_sim::twins::Fault;
use std::time::Duration;
use tokio::time::Instant;

async fn open() -> Bench {
    let mut bench = bench();
    bench.monochromator.open().await.unwrap();
    bench
}

fn inject(bench: &Bench, fault: MonochromatorFault) {
    bench.twins.inject(Fault::Monochromator(fault));
}

fn truth(bench: &Bench) -> f64 {
    bench.twins.monochromator.peek(|twin| twin.wavelength_nm(Instant::now()))
}

async fn said(link: &mut Link, request: &[u8], wait: Duration) -> Vec<u8> {
    link.send(request).await.unwrap();
    let mut bytes = Vec::new();
    let end = Instant::now() + wait;
    while let Some(byte) = link.exactly(1, end).await.unwrap() {
        bytes.extend(byte);
    }
    bytes
}

#[tokio::test(start_paused = true)]
async fn the_twin_speaks_the_worked_exchange() {
    let bench = bench();
    let mut link = bench.twins.monochromator.connector(Clock::system()).connect().await.unwrap();
    for (request, reply) in [
        (&[0x1b][..], &[0x1b][..]),
        (&[0x38, 0x0e], &[0x00, 0x01, 0x01, 0x18]),
        (&[0x32, 0x02], &[0x02, 0x18]),
        (&[0x10, 0x15, 0x7c], &[0x02, 0x18]),
        (&[0x38, 0x00], &[0x15, 0x7c, 0x02, 0x18]),
        (&[0x10, 0x15, 0x7c], &[0x42, 0x18]),
        (&[0x10, 0xff, 0xff], &[0x82, 0x18]),
        (&[0x10, 0x18, 0x18], &[0x02, 0x18]),
        (&[0x38, 0x00], &[0x18, 0x18, 0x02, 0x18]),
        (&[0x38, 0x13], &[0x2b, 0x22, 0x02, 0x18]),
        (&[0x0d, 0x00, 0x7d], &[0x02, 0x18]),
        (&[0x0d, 0x00, 0x7e], &[0x82, 0x18]),
        (&[0x33, 0xfe], &[0x0a, 0x18]),
        (&[0x33, 0x01], &[0x02, 0x18]),
        (&[0x37, 0x82], &[0x02, 0x18]),
        (&[0x36], &[0x02, 0x18]),
        (&[0x38, 0x00], &[0x18, 0x16, 0x02, 0x18]),
        (&[0x0c, 0x18, 0x16, 0x18, 0x00], &[0x12, 0x18]),
        (&[0x38, 0x00], &[0x18, 0x00, 0x02, 0x18]),
        (&[0x1a, 0x02], &[0x02, 0x18]),
        (&[0x38, 0x02], &[0x02, 0x58, 0x02, 0x18]),
        (&[0x1a, 0x03], &[0x82, 0x18]),
        (&[0xff, 0xff, 0xff], &[0x02, 0x18]),
        (&[0x38, 0x00], &[0x00, 0x00, 0x02, 0x18]),
        (&[0x63], &[]),
        (&[0x1b], &[0x1b]),
    ] {
        assert_eq!(said(&mut link, request, Duration::from_secs(30)).await, reply, "{request:02x?}");
    }
}

#[tokio::test(start_paused = true)]
async fn it_goes_where_it_is_told_and_always_arrives_from_below() {
    let mut bench = bench();
    let identity = bench.monochromator.open().await.unwrap();
    let model = "Spectral Products CM110/112, grating 1 of 2, 1200/mm".to_owned();
    assert_eq!(identity, Identity { model, firmware: String::new(), serial: "11042".into() });
    for target in [450.0, 950.0, 616.8, 500.0, 500.0, 300.0] {
        assert_eq!(bench.monochromator.tune(Nanometres(target)).await.unwrap(), Nanometres(target));
        assert!((truth(&bench) - target).abs() < 0.01, "{target}");
        assert_eq!(bench.monochromator.wavelength().await.unwrap(), Some(Nanometres(target)));
    }
    // From above: while it tunes, the drive is seen 5 nm below its target.
    bench.monochromator.tune(Nanometres(700.0)).await.unwrap();
    let twin = bench.twins.monochromator.clone();
    let watch = tokio::spawn(async move {
        let mut lowest = f64::INFINITY;
        for _ in 0..600 {
            tokio::time::sleep(Duration::from_millis(10)).await;
            lowest = lowest.min(twin.peek(|t| t.wavelength_nm(Instant::now())));
        }
        lowest
    });
    bench.monochromator.tune(Nanometres(600.0)).await.unwrap();
    assert!((watch.await.unwrap() - 595.0).abs() < 0.1);
}

#[tokio::test(start_paused = true)]
async fn what_is_not_permitted_is_refused_before_a_byte_is_sent() {
    let mut bench = bench();
    assert_eq!(bench.monochromator.tune(Nanometres(500.0)).await.unwrap_err().kind, ErrorKind::Refused, "not open");
    bench.monochromator.open().await.unwrap();
    assert_eq!(bench.monochromator.limits(), (Nanometres(300.0), Nanometres(1100.0)));
    for target in [299.9, 1100.1, -1.0, f64::NAN, f64::INFINITY, 65_536.0] {
        let error = bench.monochromator.tune(Nanometres(target)).await.unwrap_err();
        assert_eq!(error.kind, ErrorKind::Refused);
        assert!(error.message.contains("300 nm to 1100 nm is allowed"), "{error}");
        assert_eq!(truth(&bench), 0.0);
    }
}

#[tokio::test(start_paused = true)]
async fn every_fault_of_the_wire_ends_in_the_truth() {
    let faults = [
        MonochromatorFault::NoEnd,
        MonochromatorFault::Queues(true),
        MonochromatorFault::Slow(3.0),
        MonochromatorFault::Slow(1.0),
        MonochromatorFault::HalfCommand(vec![12, 1]),
        MonochromatorFault::Wire(WireFault::NoReply),
        MonochromatorFault::Wire(WireFault::Late(Duration::from_millis(900))),
        MonochromatorFault::Wire(WireFault::Cut(1)),
        MonochromatorFault::Wire(WireFault::Corrupt(0, 0x80)),
        MonochromatorFault::Wire(WireFault::Corrupt(1, 0x10)),
        MonochromatorFault::Wire(WireFault::Previous),
        MonochromatorFault::Wire(WireFault::Duplicate),
        MonochromatorFault::Wire(WireFault::Junk(vec![0x18, 0x1b])),
    ];
    let mut bench = open().await;
    for fault in faults {
        for before in 0..10 {
            for target in [450.0, 616.8] {
                if let MonochromatorFault::Wire(_) = fault {
                    (0..before).for_each(|_| inject(&bench, MonochromatorFault::Wire(WireFault::Pass)));
                }
                inject(&bench, fault.clone());
                let tuned = bench.monochromator.tune(Nanometres(target)).await;
                let tuned = tuned.unwrap_or_else(|e| panic!("{fault:?} after {before}: {e}"));
                assert!(
                    (tuned.0 - truth(&bench)).abs() < 0.051 && (tuned.0 - target).abs() < 0.21,
                    "{fault:?} {before}"
                );
            }
        }
    }
    assert_eq!(bench.twins.monochromator.peek(|twin| twin.destructive), 0);
}

#[tokio::test(start_paused = true)]
async fn it_is_opened_in_the_middle_of_any_command() {
    for half in [&[][..], &[16], &[16, 1], &[12], &[12, 1, 2, 3], &[56], &[55], &[255], &[255, 255], &[0x77, 0]] {
        let mut bench = bench();
        inject(&bench, MonochromatorFault::HalfCommand(half.to_vec()));
        bench.monochromator.open().await.unwrap_or_else(|e| panic!("{half:02x?}: {e}"));
        assert_eq!(bench.monochromator.tune(Nanometres(500.0)).await.unwrap(), Nanometres(500.0));
    }
}

#[tokio::test(start_paused = true)]
async fn a_restart_or_a_hand_on_the_keypad_is_noticed_and_mended_by_open() {
    for fault in [MonochromatorFault::Restart, MonochromatorFault::Units(1), MonochromatorFault::RestartInMove] {
        let mut bench = open().await;
        bench.monochromator.tune(Nanometres(500.0)).await.unwrap();
        inject(&bench, fault.clone());
        let error = bench.monochromator.tune(Nanometres(550.0)).await.unwrap_err();
        assert_eq!(error.kind, ErrorKind::Broken, "{fault:?}: {error}");
        assert!(error.message.contains("nanometres instead of angstroms"), "{error}");
        assert_eq!(bench.monochromator.wavelength().await.unwrap_err().kind, ErrorKind::Refused, "unknown until open");
        bench.monochromator.open().await.unwrap();
        bench.monochromator.tune(Nanometres(550.0)).await.unwrap();
        assert!((truth(&bench) - 550.0).abs() < 0.01);
    }
    let mut bench = open().await;
    bench.monochromator.tune(Nanometres(500.0)).await.unwrap();
    inject(&bench, MonochromatorFault::Turned(620.0));
    let health = bench.monochromator.health().await.unwrap();
    assert_eq!(health.warnings, ["stands at 620 nm, where no command of ours brought it"]);
}

#[tokio::test(start_paused = true)]
async fn a_drive_that_misses_or_never_arrives_is_an_error() {
    let mut bench = open().await;
    inject(&bench, MonochromatorFault::Off(-7));
    let error = bench.monochromator.tune(Nanometres(500.0)).await.unwrap_err();
    assert_eq!(error.kind, ErrorKind::Broken);
    assert!(error.message.contains("stands at 499.3 nm instead of 500 nm"), "{error}");
    inject(&bench, MonochromatorFault::NeverArrives);
    let begun = Instant::now();
    assert_eq!(bench.monochromator.tune(Nanometres(900.0)).await.unwrap_err().kind, ErrorKind::Timeout);
    assert!(begun.elapsed() < Duration::from_secs(120), "virtual time");
}

#[tokio::test(start_paused = true)]
async fn another_serial_number_is_another_device() {
    let mut spec = goniod_sim::twins::TwinsSpec::with_serials("1001", "1002", "1003");
    spec.monochromator.serial = 11_043;
    let mut bench = super::bench_of(spec);
    let error = bench.monochromator.open().await.unwrap_err();
    assert_eq!(error.kind, ErrorKind::WrongDevice);
    assert!(error.message.contains("11043") && error.message.contains("11042"), "{error}");
}

#[tokio::test(start_paused = true)]
async fn an_unplugged_adapter_is_lost_and_found_again() {
    let mut bench = open().await;
    bench.twins.inject(Fault::Unplugged("sim:monochromator".into(), Duration::from_secs(5)));
    assert_eq!(bench.monochromator.tune(Nanometres(500.0)).await.unwrap_err().kind, ErrorKind::Lost);
    tokio::time::sleep(Duration::from_secs(6)).await;
    bench.monochromator.make_safe().await.unwrap();
    bench.monochromator.open().await.unwrap();
    bench.monochromator.tune(Nanometres(500.0)).await.unwrap();
}
