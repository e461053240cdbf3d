//! Tests of the spectrometers' bytes: the worked exchange of the data sheets, and what is refused.
#![allow(clippy::unwrap_used, clippy::expect_used)]

use super::*;
use proptest::prelude::*;

const USB2000: &Model = &MODELS[0];
const USB4000: &Model = &MODELS[2];

#[test]
fn commands_are_the_worked_exchange() {
    assert_eq!(initialise(), [0x01]);
    assert_eq!(query_slot(1), [0x05, 0x01]);
    assert_eq!(USB2000.set_time(100), [0x02, 0x64, 0x00]);
    assert_eq!(USB4000.set_time(65_535_000), [0x02, 0x18, 0xFC, 0xE7, 0x03]);
    assert_eq!((query_status(), request_spectrum()), (vec![0xFE], vec![0x09]));
    assert_eq!(trigger(FREE_RUNNING), [0x0A, 0, 0]);
}

#[test]
fn slots_are_the_worked_exchange() {
    let serial = b"\x05\x00USB2G1234\0\0\0\0\0\0";
    assert_eq!(slot_text(slot_bytes(serial, 0).unwrap()), Some("USB2G1234"));
    assert!(slot_bytes(serial, 1).is_none() && slot_bytes(&serial[..9], 0).is_none());
    let number = b"\x05\x01 345.6789\0\0\0\0\0\0";
    assert_eq!(slot_number(slot_bytes(number, 1).unwrap()), Some(345.6789));
    assert_eq!(slot_number(b"-1.23e-05\0garb\xFF\0"), Some(-1.23e-5));
    for bad in [&b"\0\0\0"[..], b"nan", b"\xFF\xFF\xFF", b"1.2.3", b"    ", b"inf"] {
        assert_eq!(slot_number(bad), None, "{bad:?}");
    }
    assert_eq!(saturation_level(b"\0\0\0\0\x30\xF2\0", 65_535), Some(62_000));
    assert_eq!(saturation_level(&[0; 15], 65_535), Some(65_535));
}

#[test]
fn a_status_tells_its_own_byte_order() {
    let big = USB2000.status(&[8, 0, 0, 0x64, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0]).unwrap();
    let little = USB2000.status(&[0, 8, 0x64, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0]).unwrap();
    assert_eq!((big, big.time, big.busy), (little, 100, true));
    assert_eq!(USB2000.status(&[8, 8, 0, 0x64, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0]), None);
    let plus = USB4000.status(&[0, 15, 0xA0, 0x86, 1, 0, 0, 0, 0, 15, 0, 0, 0, 0, 0x80, 0]).unwrap();
    assert_eq!((plus.time, plus.high_speed), (100_000, true));
    assert_eq!(USB4000.status(&[0; 15]), None);
}

#[test]
fn a_spectrum_is_unpacked_as_the_data_sheet_packs_it() {
    let mut bytes = vec![0; 4097];
    bytes[4096] = SYNC;
    // Pixel 100 = 0xABC: low byte at 128 + 36, high byte 64 later, its upper four bits free.
    (bytes[164], bytes[228]) = (0xBC, 0x7A);
    let counts = USB2000.counts(&bytes).unwrap();
    assert_eq!((counts.len(), counts[100], counts.iter().filter(|&&c| c > 0).count()), (2048, 0xABC, 1));
    bytes[4096] = 0x68;
    assert_eq!(USB2000.counts(&bytes), None);
    let mut words = vec![0; 7681];
    (words[200], words[201], words[7680]) = (0xBC, 0x7A, SYNC);
    assert_eq!(USB4000.counts(&words).unwrap()[100], 0x7ABC);
    assert_eq!(USB4000.counts(&words[1..]), None);
}

proptest! {
    #[test]
    fn any_bytes_are_read_or_refused(bytes in proptest::collection::vec(any::<u8>(), 0..40), slot in 0_u8..20) {
        for model in &MODELS {
            prop_assert!(model.counts(&bytes).is_none());
            if let Some(status) = model.status(&bytes) {
                prop_assert!(bytes.len() == 16 && status.time <= u64::from(u32::MAX));
            }
        }
        if let Some(body) = slot_bytes(&bytes, slot) {
            prop_assert_eq!(&bytes[..2], &[5, slot]);
            prop_assert!(slot_number(body).is_none_or(f64::is_finite));
            let _ = saturation_level(body, 65_535);
        }
    }

    #[test]
    fn only_the_right_length_and_end_make_a_spectrum(seed in any::<u64>(), cut in 0_usize..300, last in any::<u8>()) {
        for model in &MODELS {
            let mut bytes: Vec<u8> = (0..model.spectrum_bytes() as u64 - 1).map(|i| (seed ^ (i * 31)) as u8).collect();
            bytes.push(last);
            prop_assert_eq!(model.counts(&bytes).is_some(), last == SYNC);
            if cut > 0 {
                bytes.truncate(bytes.len() - cut);
                prop_assert!(model.counts(&bytes).is_none());
            }
        }
    }
}
