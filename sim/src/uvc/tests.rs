//! The camera driven request by request, as a host would, on a clock of the test's own.

#![allow(clippy::unwrap_used, clippy::expect_used)]

use super::controls::{GET_CUR, SET_CUR};
use super::*;
use crate::scene::{Painted, Reading};

/// A host that has one camera and turns the time.
struct Host {
    camera: UvcTwin,
    now: Instant,
}

/// A picture put together from payloads.
struct Picture {
    bytes: Vec<u8>,
    error: bool,
    id: u8,
}

impl Host {
    fn new() -> Host {
        let config = UvcConfig { readout: Duration::from_millis(1), ..UvcConfig::new("SN42") };
        let mut host = Host { camera: UvcTwin::new(config, Arc::new(Painted)), now: Instant::now() };
        for (entity, selector, value) in [(1, 2, vec![1]), (1, 4, vec![100, 0, 0, 0]), (2, 9, vec![100, 0])] {
            host.set(entity, selector, &value);
        }
        host
    }

    fn request(&mut self, request: u8, index: u16, selector: u16, bytes: &[u8]) -> Answer {
        let request_type = if request == SET_CUR { 0x21 } else { 0xa1 };
        let setup = SetupPacket { request_type, request, value: selector << 8, index, length: 64 };
        self.camera.control(setup, bytes, self.now)
    }

    fn set(&mut self, entity: u16, selector: u16, value: &[u8]) {
        assert_eq!(self.request(SET_CUR, entity << 8, selector, value), Answer::Data(Vec::new()));
    }

    fn exposure(&mut self, raw: u32) {
        self.set(1, 4, &raw.to_le_bytes());
    }

    /// Agrees on a format (from 1) at 100 frames a second at most and starts.
    fn stream(&mut self, format: u8) {
        let mut block = vec![0; 26];
        (block[2], block[3]) = (format, 1);
        block[4..8].copy_from_slice(&100_000_u32.to_le_bytes());
        assert_eq!(self.request(SET_CUR, 1, 1, &block), Answer::Data(Vec::new()));
        let Answer::Data(agreed) = self.request(GET_CUR, 1, 1, &[]) else { panic!("no agreement") };
        assert_eq!(agreed[4..8], 333_333_u32.to_le_bytes(), "an interval too short is lengthened");
        assert_eq!(self.request(SET_CUR, 1, 2, &agreed), Answer::Data(Vec::new()));
    }

    fn picture(&mut self) -> Picture {
        let mut picture = Picture { bytes: Vec::new(), error: false, id: 0 };
        for _ in 0..10_000 {
            match self.camera.bulk_in(STREAM, PAYLOAD, self.now) {
                Answer::Data(payload) => {
                    assert!(payload.len() <= PAYLOAD && payload[0] == 2);
                    picture.bytes.extend(&payload[2..]);
                    picture.error |= payload[1] & ERROR != 0;
                    picture.id = payload[1] & FRAME_ID;
                    if payload[1] & END_OF_FRAME != 0 {
                        return picture;
                    }
                }
                Answer::Nak => self.now = self.camera.due().unwrap().max(self.now + Duration::from_micros(10)),
                Answer::Stall => panic!("a stall"),
            }
        }
        panic!("no picture");
    }

    fn grey(&mut self) -> Reading {
        let bytes = self.picture().bytes;
        if bytes.len() != 320 * 240 {
            return Reading::Damaged;
        }
        Painted::read(320, 240, 0xff, |i| u16::from(bytes[i]))
    }
}

fn exposure_us(reading: Reading) -> u64 {
    match reading {
        Reading::Whole(tag) => tag.exposure_us,
        other => panic!("{other:?}"),
    }
}

#[test]
fn every_format_gives_whole_pictures_of_its_size() {
    for (format, mode) in (1..).zip(Mode::ALL) {
        let mut host = Host::new();
        host.stream(format);
        for number in 1..4 {
            let picture = host.picture();
            assert_eq!(picture.bytes.len(), mode.bytes());
            assert_eq!(picture.id, number % 2, "the frame id toggles");
            let step = mode.format.bytes_per_pixel();
            let level = |i: usize| match mode.format {
                UvcFormat::Y16 => u16::from_le_bytes([picture.bytes[2 * i], picture.bytes[2 * i + 1]]),
                _ => u16::from(picture.bytes[step * i]),
            };
            let (width, height) = (usize::from(mode.width), usize::from(mode.height));
            let reading = Painted::read(width, height, mode.format.max_level(), level);
            assert!(matches!(reading, Reading::Whole(tag) if tag.frame_number == u64::from(number)), "{reading:?}");
        }
    }
}

#[test]
fn exposures_take_their_time_and_follow_the_control_after_the_latency() {
    let mut host = Host::new();
    host.camera.faults().latency_frames = 2;
    host.stream(3);
    assert_eq!(exposure_us(host.grey()), 10_000);
    let began = host.now;
    host.exposure(5000);
    // The exposure under way and two more still have the old value.
    let seen: Vec<u64> = (0..5).map(|_| exposure_us(host.grey())).collect();
    assert_eq!(seen, [10_000, 10_000, 500_000, 500_000, 500_000]);
    assert!(host.now - began >= Duration::from_millis(1500));
    let last = host.camera.truth().last().unwrap().clone();
    assert_eq!((last.settings.exposure, last.commanded.exposure, last.fault), (5000, 5000, None));
}

#[test]
fn gamma_brightness_and_the_automatic_exposure_act() {
    let mut host = Host::new();
    host.set(2, 9, &200_u16.to_le_bytes());
    host.stream(3);
    assert_eq!(host.grey(), Reading::Damaged, "levels went through a curve");
    host.set(2, 9, &100_u16.to_le_bytes());
    host.set(1, 2, &[8]);
    host.grey();
    assert_eq!(exposure_us(host.grey()), 33_300, "the camera's own choice");
    host.set(2, 2, &5_i16.to_le_bytes());
    host.grey();
    assert_eq!(host.grey(), Reading::Damaged);
    host.camera.reset(host.now);
    assert_eq!((host.camera.settings().gamma, host.camera.is_streaming()), (200, false), "power-up values");
}

#[test]
fn faults_do_what_they_say_and_stand_in_the_record() {
    let mut host = Host::new();
    host.stream(3);
    host.grey();
    host.camera.faults().half_changed = true;
    host.exposure(200);
    let readings: Vec<Reading> = (0..3).map(|_| host.grey()).collect();
    assert!(
        readings
            .iter()
            .any(|r| matches!(r, Reading::Mixed(top, low) if (top.exposure_us, low.exposure_us) == (10_000, 20_000)))
    );
    host.camera.faults().short_per_1000 = 1000;
    assert!((0..3).any(|_| host.picture().bytes.len() == 320 * 240 / 2));
    *host.camera.faults() = Faults { error_per_1000: 1000, ..Faults::default() };
    assert!((0..3).any(|_| host.picture().error));
    *host.camera.faults() = Faults { repeated_per_1000: 1000, ..Faults::default() };
    let (_, a, b) = (host.picture(), host.picture(), host.picture());
    assert_eq!(a.bytes, b.bytes);
    *host.camera.faults() = Faults { stale_per_1000: 1000, ..Faults::default() };
    host.grey();
    let newest = host.camera.truth().last().unwrap().clone();
    assert_eq!(newest.fault, Some(FrameFault::Stale));
    for fault in [FrameFault::HalfChanged, FrameFault::Short, FrameFault::ErrorBit, FrameFault::Repeated] {
        assert!(host.camera.truth().iter().any(|t| t.fault == Some(fault)), "{fault:?}");
    }
}

#[test]
fn a_lost_picture_leaves_its_header_so_that_the_host_can_count() {
    let mut host = Host::new();
    host.stream(3);
    host.grey();
    host.camera.faults().dropped_per_1000 = 500;
    let empty = (0..40).filter(|_| host.picture().bytes.is_empty()).count();
    assert!(empty > 0);
    host.camera.faults().dropped_per_1000 = 0;
    // A host that looks away loses pictures, and their number shows.
    let before = host.camera.truth().len();
    host.now += Duration::from_millis(200);
    (0..6).for_each(|_| drop(host.picture()));
    assert!(host.camera.truth()[before..].iter().any(|t| t.fault == Some(FrameFault::Overrun)));
}

#[test]
fn a_camera_that_hangs_answers_nothing_and_a_mute_one_only_requests() {
    let mut host = Host::new();
    host.stream(3);
    host.camera.faults().frozen = true;
    host.now += Duration::from_secs(1);
    assert_eq!(host.camera.bulk_in(STREAM, PAYLOAD, host.now), Answer::Nak);
    assert_eq!(host.request(GET_CUR, 1 << 8, 4, &[]), Answer::Nak);
    *host.camera.faults() = Faults { mute: true, ..Faults::default() };
    assert_eq!(host.camera.bulk_in(STREAM, PAYLOAD, host.now), Answer::Nak);
    assert_eq!(host.request(GET_CUR, 1 << 8, 4, &[]), Answer::Data(vec![100, 0, 0, 0]));
}

#[test]
fn clearing_the_endpoint_ends_the_stream_and_a_new_commit_begins_another() {
    let mut host = Host::new();
    host.stream(3);
    host.grey();
    host.camera.clear_halt(STREAM, host.now);
    assert_eq!(host.camera.bulk_in(STREAM, PAYLOAD, host.now + Duration::from_secs(1)), Answer::Nak);
    host.stream(2);
    assert_eq!(host.picture().bytes.len(), 640 * 480 * 2);
}
