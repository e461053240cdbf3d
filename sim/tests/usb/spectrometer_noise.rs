//! Noise on the spectrometer's answers: whatever the driver then says is a period that it asked for.

use super::ocean;
use goniod_drivers::units::ExposureTime;
use goniod_sim::firmware::usb::UsbFault;
use goniod_sim::firmware::usb::oceanoptics::{OceanFault, OceanModel};
use proptest::prelude::*;
use std::time::Duration;
use tokio::time::Instant;

fn fault(late_ms: u64) -> impl Strategy<Value = UsbFault> {
    prop_oneof![
        4 => Just(UsbFault::Pass),
        1 => Just(UsbFault::NoReply),
        1 => Just(UsbFault::Duplicate),
        1 => Just(UsbFault::Previous),
        1 => (0..late_ms).prop_map(|ms| UsbFault::Late(Duration::from_millis(ms))),
        1 => (0_usize..4097).prop_map(UsbFault::Cut),
        1 => (0_usize..40, 1_u8..=255).prop_map(|(place, mask)| UsbFault::Corrupt(place, mask)),
        1 => proptest::collection::vec(any::<u8>(), 1..70).prop_map(UsbFault::Junk),
        1 => Just(UsbFault::Stall),
        1 => Just(UsbFault::Babble),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 12, ..ProptestConfig::default() })]

    #[test]
    fn a_spectrum_is_always_one_that_began_after_the_call_with_the_time_that_was_set(
        spectra in proptest::collection::vec(fault(1500), 24),
        queries in proptest::collection::vec(fault(900), 60),
    ) {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_time().start_paused(true).build().unwrap();
        runtime.block_on(async {
            let (bus, mut driver) = ocean(OceanModel::Usb2000).await;
            bus.with(|twin| {
                let now = Instant::now();
                spectra.into_iter().for_each(|fault| twin.inject(OceanFault::Spectrum(fault), now));
                queries.into_iter().for_each(|fault| twin.inject(OceanFault::Query(fault), now));
            });
            for n in 0..12_u64 {
                let time = ExposureTime((20 + 10 * (n % 3)) * 1000);
                if driver.apply(time).await.is_err() {
                    continue;
                }
                let call = Instant::now();
                let Ok(spectrum) = driver.acquire().await else { continue };
                assert_eq!(spectrum.exposure, time);
                // Dark subtraction is a shift and the polynomial is monotonic, so ranks and differences tell the period.
                let dark = |raw: &[u16]| raw[2..24].iter().map(|&c| f64::from(c)).sum::<f64>() / 22.0;
                let same = bus.with(|twin| twin.exposures().rev().find(|e| {
                    let level = dark(&e.raw);
                    e.raw[26..].iter().zip(&spectrum.counts).all(|(&raw, &count)| {
                        let v = f64::from(raw) - level;
                        (count - v).abs() <= 0.021 * v.abs() + 1e-6
                    })
                }).cloned());
                let exposure = same.expect("the spectrum is none that the device took");
                assert!(exposure.began >= call, "began before the call");
                assert_eq!(exposure.ended - exposure.began, time.duration());
            }
        });
    }
}
