//! Noise on the lines: whatever a driver then says is true.

use super::bench;
use goniod_drivers::contract::ShutterState::{Closed, Open};
use goniod_drivers::units::{Degrees, Nanometres, Slot};
use goniod_sim::firmware::WireFault;
use goniod_sim::firmware::cm110::MonochromatorFault;
use goniod_sim::firmware::fw212c::WheelFault;
use goniod_sim::firmware::newport_1830c::MonitorFault;
use goniod_sim::firmware::sc10::ShutterFault;
use goniod_sim::firmware::zaber::ZaberFault;
use goniod_sim::pose::PoseSource;
use goniod_sim::twins::Fault;
use proptest::prelude::*;
use std::time::Duration;
use tokio::time::Instant;

fn wire_fault() -> impl Strategy<Value = WireFault> {
    prop_oneof![
        6 => Just(WireFault::Pass),
        1 => Just(WireFault::NoReply),
        1 => Just(WireFault::Duplicate),
        1 => Just(WireFault::Previous),
        1 => (0_u64..1200).prop_map(|ms| WireFault::Late(Duration::from_millis(ms))),
        1 => (0_usize..40).prop_map(WireFault::Cut),
        3 => (0_usize..80, 1_u8..=255).prop_map(|(place, mask)| WireFault::Corrupt(place, mask)),
        1 => proptest::collection::vec(any::<u8>(), 1..12).prop_map(WireFault::Junk),
    ]
}

fn paused() -> tokio::runtime::Runtime {
    tokio::runtime::Builder::new_current_thread().enable_time().start_paused(true).build().unwrap()
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 40, ..ProptestConfig::default() })]

    /// 40 cases of 50 disturbed replies: 2,000 noisy exchanges.
    #[test]
    fn an_axis_never_reports_an_angle_where_it_is_not(faults in proptest::collection::vec(wire_fault(), 50)) {
        paused().block_on(async {
            let mut bench = bench();
            bench.axes[0].open().await.unwrap();
            bench.axes[0].home().await.unwrap();
            faults.into_iter().for_each(|f| bench.twins.inject(Fault::Holder(ZaberFault::Wire(f))));
            for n in 0..8 {
                let target = f64::from(n % 3) * 20.0 + 5.0;
                let said = bench.axes[0].move_to(Degrees(target)).await;
                let truth = bench.twins.pose(Instant::now()).tilt_deg;
                if let Ok(said) = said {
                    assert!((said.0 - truth).abs() < 0.001 && (truth - target).abs() < 0.01, "{said} {truth} {target}");
                }
                // a move whose answer was lost may still go on: what is said then is late by its exchange
                tokio::time::sleep(Duration::from_secs(20)).await;
                if let Ok(Some(said)) = bench.axes[0].position().await {
                    let truth = bench.twins.pose(Instant::now()).tilt_deg;
                    assert!((said.0 - truth).abs() < 0.001, "position {said} {truth}");
                }
            }
        });
    }

    /// The wheel's and the shutter's lines have no checksum: echo, agreement of two answers and the final question must do.
    #[test]
    fn wheel_and_shutter_never_report_what_is_not(faults in proptest::collection::vec(wire_fault(), 50)) {
        paused().block_on(async {
            let mut bench = bench();
            bench.wheel.open().await.unwrap();
            bench.shutter.open().await.unwrap();
            for fault in faults {
                bench.twins.inject(Fault::Wheel(WheelFault::Wire(fault.clone())));
                bench.twins.inject(Fault::Shutter(ShutterFault::Wire(fault)));
            }
            for n in 0..4_u8 {
                let place = n * 5 % 12 + 1;
                if bench.wheel.select(Slot(place)).await.is_ok() {
                    assert_eq!(bench.twins.pose(Instant::now()).slot, Some(place));
                }
                let state = if n % 2 == 0 { Open } else { Closed };
                if bench.shutter.set(state).await.is_ok() {
                    assert_eq!(bench.twins.pose(Instant::now()).shutter_open, state == Open);
                }
            }
        });
    }

    /// No checksum and bare bytes: agreement of two answers and the final question must do.
    #[test]
    fn a_monochromator_never_reports_a_wavelength_where_it_is_not(faults in proptest::collection::vec(wire_fault(), 50)) {
        paused().block_on(async {
            let mut bench = bench();
            bench.monochromator.open().await.unwrap();
            faults.into_iter().for_each(|f| bench.twins.inject(Fault::Monochromator(MonochromatorFault::Wire(f))));
            for n in 0..8 {
                let target = [450.0, 616.8, 500.0, 950.0][n % 4];
                let said = bench.monochromator.tune(Nanometres(target)).await;
                let truth = bench.twins.monochromator.peek(|twin| twin.wavelength_nm(Instant::now()));
                if let Ok(said) = said {
                    assert!((said.0 - truth).abs() < 0.051 && (truth - target).abs() < 0.21, "{said} {truth} {target}");
                }
                tokio::time::sleep(Duration::from_secs(60)).await;
            }
            assert_eq!(bench.twins.monochromator.peek(|twin| twin.destructive), 0);
        });
    }

    /// One disturbed reply in six at most: the median of three is then never a corrupted one.
    #[test]
    fn a_light_monitor_never_reports_light_that_is_not_there(faults in proptest::collection::vec(wire_fault(), 20)) {
        paused().block_on(async {
            let mut bench = bench();
            bench.light_monitor.open().await.unwrap();
            for fault in faults {
                bench.twins.inject(Fault::LightMonitor(MonitorFault::Wire(fault)));
                (0..5).for_each(|_| bench.twins.inject(Fault::LightMonitor(MonitorFault::Wire(WireFault::Pass))));
            }
            for _ in 0..12 {
                if let Ok(reading) = bench.light_monitor.read().await {
                    assert!((reading.power_w / 1e-3 - 1.0).abs() < 0.002, "{reading:?}");
                    assert_eq!(reading.wavelength, Nanometres(550.0));
                    assert!(!reading.saturated);
                }
                tokio::time::sleep(Duration::from_secs(5)).await;
            }
        });
    }
}
