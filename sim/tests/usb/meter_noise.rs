//! Noise on the meter's answers: whatever the driver then says is what the meter measured last.

use super::meter;
use goniod_sim::firmware::usb::UsbFault;
use goniod_sim::firmware::usb::pm100::Pm100Fault;
use proptest::prelude::*;
use std::time::Duration;

fn fault() -> impl Strategy<Value = UsbFault> {
    prop_oneof![
        6 => Just(UsbFault::Pass),
        1 => Just(UsbFault::NoReply),
        2 => Just(UsbFault::Duplicate),
        2 => Just(UsbFault::Previous),
        1 => (0_u64..3000).prop_map(|ms| UsbFault::Late(Duration::from_millis(ms))),
        1 => (0_usize..40).prop_map(UsbFault::Cut),
        3 => (0_usize..40, 1_u8..=255).prop_map(|(place, mask)| UsbFault::Corrupt(place, mask)),
        1 => "[0-9.E+-]{1,12}".prop_map(|text| UsbFault::Junk(text.into_bytes())),
        1 => Just(UsbFault::Stall),
        1 => Just(UsbFault::Babble),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 100, ..ProptestConfig::default() })]

    /// 100 cases of 100 disturbed answers: 10,000 noisy exchanges.
    #[test]
    fn a_meter_never_reports_what_it_did_not_measure(faults in proptest::collection::vec(fault(), 100)) {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_time().start_paused(true).build().unwrap();
        runtime.block_on(async {
            let (bus, mut driver) = meter().await;
            bus.with(|twin| faults.into_iter().for_each(|fault| twin.inject(Pm100Fault::Wire(fault))));
            let mut good = 0;
            for _ in 0..60 {
                if let Ok(reading) = driver.read().await {
                    good += 1;
                    let truth = bus.with(|twin| twin.history().next_back().unwrap());
                    assert_eq!(reading.power_w, truth);
                }
            }
            assert!(good > 0, "the noise ends before the readings do");
        });
    }
}
