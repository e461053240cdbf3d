//! The twins on their endpoints, byte for byte as the sheets say, and as third-party clients use them.

use super::{MeterBus, OceanBus};
use goniod_drivers::clock::Clock;
use goniod_drivers::transport::usb::{Setup, UsbConnector, UsbError, UsbLink};
use goniod_sim::firmware::usb::oceanoptics::{OceanModel, OceanSpec, OceanTwin};
use goniod_sim::firmware::usb::pm100::{Pm100Spec, Pm100Twin};
use goniod_sim::front::UsbBus;
use std::time::Duration;
use tokio::time::Instant;

const LIMIT: Duration = Duration::from_millis(300);

async fn ocean(model: OceanModel) -> (OceanBus, UsbLink) {
    let bus = UsbBus::new("usb", OceanTwin::new(OceanSpec::new(model, "USB2G1234"), Instant::now()));
    let link = bus.connector(Clock::system()).connect().await.unwrap();
    (bus, link)
}

async fn meter() -> (MeterBus, UsbLink) {
    let bus = UsbBus::new("usb", Pm100Twin::new(Pm100Spec::new("P0001234")));
    let link = bus.connector(Clock::system()).connect().await.unwrap();
    (bus, link)
}

#[tokio::test(start_paused = true)]
async fn a_usb2000_speaks_the_worked_exchange() {
    let (_bus, mut link) = ocean(OceanModel::Usb2000).await;
    for (out, reply) in [
        (&[5, 0][..], &b"\x05\x00USB2G1234\0\0\0\0\0\0"[..]),
        (&[5, 1], b"\x05\x01 345.6789\0\0\0\0\0\0"),
        (&[8], b"\x08USB2G1234\0\0\0\0\0\0\0"),
    ] {
        link.send(2, out, LIMIT).await.unwrap();
        assert_eq!(link.read(0x87, 64, LIMIT).await.unwrap(), reply);
    }
    link.send(2, &[2, 0x64, 0], LIMIT).await.unwrap();
    link.send(2, &[0xFE], LIMIT).await.unwrap();
    assert_eq!(link.read(0x87, 64, LIMIT).await.unwrap(), [8, 0, 0, 0x64, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0]);
    link.send(2, &[9], LIMIT).await.unwrap();
    let spectrum = link.read(0x82, 4097, LIMIT).await.unwrap();
    assert_eq!((spectrum.len(), spectrum.last()), (4097, Some(&0x69)));
}

#[tokio::test(start_paused = true)]
async fn setters_out_of_range_and_unknown_commands_change_nothing() {
    let (bus, mut link) = ocean(OceanModel::Usb2000).await;
    for out in [&[2, 2, 0][..], &[2, 0, 0, 1, 0], &[4, 0, 0], &[0x42], &[2], &[0x6B, 1], &[]] {
        link.send(2, out, LIMIT).await.unwrap();
    }
    assert_eq!(bus.with(|twin| twin.time_us()), 100_000);
    assert_eq!(link.read(0x87, 64, LIMIT).await, Err(UsbError::Timeout));
    // The five-byte form of libseabreeze is taken too.
    link.send(2, &[2, 0x2C, 1, 0, 0], LIMIT).await.unwrap();
    assert_eq!(bus.with(|twin| twin.time_us()), 300_000);
}

/// As a well-known open client reads it: no init, status, gain slot, then two parts from two endpoints.
#[tokio::test(start_paused = true)]
async fn a_usb4000_gives_its_spectrum_on_two_endpoints_at_high_speed() {
    let (bus, mut link) = ocean(OceanModel::Usb4000).await;
    link.send(1, &[0xFE], LIMIT).await.unwrap();
    let status = link.read(0x81, 16, LIMIT).await.unwrap();
    assert_eq!((status.len(), &status[..2], status[14]), (16, &[0, 15][..], 0x80));
    link.send(1, &[2, 0x10, 0x27, 0, 0], LIMIT).await.unwrap();
    link.send(1, &[9], LIMIT).await.unwrap();
    let mut bytes = link.read(0x86, 2048, LIMIT).await.unwrap();
    assert_eq!(bytes.len(), 2048);
    bytes.extend(link.read(0x82, 5633, LIMIT).await.unwrap());
    assert_eq!((bytes.len(), bytes.last()), (7681, Some(&0x69)));
    let words: Vec<u16> = bytes.chunks_exact(2).map(|w| u16::from_le_bytes([w[0], w[1]])).collect();
    assert!(bus.with(|twin| twin.exposures().next_back().unwrap().raw == words));
}

#[tokio::test(start_paused = true)]
async fn the_sync_byte_and_the_halts_are_where_the_sheet_says() {
    let (_bus, mut link) = ocean(OceanModel::Usb2000).await;
    link.send(2, &[9], LIMIT).await.unwrap();
    // A buffer that holds 64 packets leaves the sync byte behind.
    assert_eq!(link.read(0x82, 4096, LIMIT).await.unwrap().len(), 4096);
    assert_eq!(link.read(0x82, 4096, LIMIT).await.unwrap(), [0x69]);
    assert_eq!(
        link.control_in(Setup { request_type: 0xC0, request: 1, value: 0, index: 0 }, 8, LIMIT).await,
        Err(UsbError::Stall)
    );
    assert_eq!(link.info().manufacturer, "USB2000 2.41.3");
    let ends: Vec<u8> = link.info().endpoints.iter().map(|e| e.address).collect();
    assert_eq!(ends, [0x02, 0x87, 0x82, 0x07]);
}

#[tokio::test(start_paused = true)]
async fn a_meter_speaks_the_worked_exchange() {
    let (_bus, mut link) = meter().await;
    link.send(2, b"\x01\x01\xFE\x00\x06\x00\x00\x00\x01\x00\x00\x00*IDN?\n\x00\x00", LIMIT).await.unwrap();
    link.send(2, b"\x02\x02\xFD\x00\x00\x04\x00\x00\x00\x00\x00\x00", LIMIT).await.unwrap();
    let answer = link.read(0x82, 1036, LIMIT).await.unwrap();
    assert_eq!(answer, b"\x02\x02\xFD\x00\x1F\x00\x00\x00\x01\x00\x00\x00THORLABS,PM100D,P0001234,2.4.0\n\x00");
}

/// Sends a message, reads the answer in parts of `size`.
async fn ask(link: &mut UsbLink, text: &str, size: u8) -> Option<String> {
    let mut out = vec![1, 7, !7, 0, text.len() as u8, 0, 0, 0, 1, 0, 0, 0];
    out.extend(text.as_bytes());
    out.resize(out.len().next_multiple_of(4), 0);
    link.send(2, &out, LIMIT).await.unwrap();
    let mut whole = Vec::new();
    for tag in 8_u8.. {
        link.send(2, &[2, tag, !tag, 0, size, 0, 0, 0, 0, 0, 0, 0], LIMIT).await.unwrap();
        let part = link.read(0x82, 12 + usize::from(size), LIMIT).await.ok()?;
        assert_eq!(&part[..3], &[2, tag, !tag]);
        whole.extend_from_slice(&part[12..12 + usize::from(part[4])]);
        if part[8] == 1 {
            break;
        }
    }
    Some(String::from_utf8(whole).unwrap().trim_end().to_owned())
}

#[tokio::test(start_paused = true)]
async fn a_meter_answers_in_parts_and_keeps_an_error_queue() {
    let (_bus, mut link) = meter().await;
    for (question, answer) in [
        ("*idn?", "THORLABS,PM100D,P0001234,2.4.0"),
        ("SYST:SENS:IDN?", "S120VC,12345,10-Jan-2010,1,1,33"),
        ("sense:correction:wavelength 550.5;:SENS:CORR:WAV?", "5.505000E+02"),
        ("SENS:CORR:WAV 600;WAV?;WAV? MAX", "6.000000E+02;1.100000E+03"),
        ("SENS:AVER:COUN 30;:SENS:AVER:COUN?", "30"),
        ("POW:RANG:AUTO OFF;AUTO?", "0"),
        ("SENS:POW:UNIT?", "W"),
        ("INP:FILT 1;:INP:PDI:FILT:LPAS:STAT?", "1"),
        ("CONF:POW;:CONF?", "POW"),
        ("SENS:AVER:1000;NONSENSE;SYST:ERR?", "-113,\"Undefined header\""),
        ("SYST:ERR?", "-113,\"Undefined header\""),
        ("SENS:CORR:WAV 5000;WAV;WAV X;SYST:ERR?", "-222,\"Data out of range\""),
        ("SYST:ERR?;ERR?;ERR?", "-109,\"Missing parameter\";-104,\"Data type error\";+0,\"No error\""),
        ("*CLS;SYST:ERR?", "+0,\"No error\""),
    ] {
        for size in [255, 16] {
            if size == 255 || !question.contains("ERR") {
                assert_eq!(
                    ask(&mut link, question, size).await.as_deref(),
                    Some(answer),
                    "{question} in parts of {size}"
                );
            }
        }
    }
    for (question, answer) in [
        ("*STB?", "0"),
        ("STAT:OPER:PTR 512;:STAT:OPER:PTR?;NTR?", "512;0"),
        ("CORR:BEAM 5;BEAM?;BEAM? MAX", "5.000000E+00;2.540000E+01"),
        ("CORR?", "0.000000E+00"),
        ("CONF:CURR;:CONF?", "CURR"),
        ("MEAS:FREQ?;:CONF?", "0.000000E+00;FREQ"),
        ("SYST:LFR?;BEEP:VOL?", "50;1.000000E+00"),
        ("MEAS:TEMP?;:SYST:ERR?", "-221,\"Settings conflict\""),
        ("*ESE 16;*STB?;*ESR?", "32;16"),
        ("SYST:BEEP:VOL 2;*ESR?;*STB?;*CLS;*ESR?", "16;4;0"),
        ("*RST;CONF?", "POW"),
    ] {
        assert_eq!(ask(&mut link, question, 255).await.as_deref(), Some(answer), "{question}");
    }
    ask(&mut link, "SENS:CORR:WAV 550;BEAM 10;:SENS:AVER 50;*OPC?", 255).await;
    let read = async |link: &mut UsbLink, what: &str| ask(link, what, 255).await.unwrap().parse::<f64>().unwrap();
    // The first reading in a new range is off.
    read(&mut link, "MEAS:POW?").await;
    let (watts, amperes) = (read(&mut link, "MEAS:POW?").await, read(&mut link, "MEAS:CURR?").await);
    assert!((amperes / watts - 0.33).abs() < 1e-3, "responsivity at 550 nm: {amperes} A of {watts} W");
    let density = read(&mut link, "MEAS:PDEN?").await;
    assert!((density / watts * std::f64::consts::FRAC_PI_4 - 1.0).abs() < 1e-3, "a beam of 1 cm: {density}");
    let power: f64 = ask(&mut link, "MEAS:POW?\n", 255).await.unwrap().parse().unwrap();
    let again: f64 = ask(&mut link, "FETCH?\n", 255).await.unwrap().parse().unwrap();
    assert!((power / again - 1.0).abs() < 1e-9 && power > 0.0, "{power} {again}");
    assert_eq!(ask(&mut link, "SENS:CORR:WAV 550", 255).await, None, "a setting has no answer");
    assert_eq!(ask(&mut link, "SYST:ERR?", 255).await.as_deref(), Some("-420,\"Query UNTERMINATED\""));
}

#[tokio::test(start_paused = true)]
async fn the_class_requests_are_there() {
    let (_bus, mut link) = meter().await;
    let class = |to, request, value, index| Setup { request_type: to, request, value, index };
    let capabilities = link.control_in(class(0xA1, 7, 0, 0), 24, LIMIT).await.unwrap();
    assert_eq!((capabilities.len(), capabilities[0], &capabilities[2..4]), (24, 1, &[0, 1][..]));
    assert_eq!(link.info().class, (0xFE, 3, 1));
    // A read that waits is aborted by its tag, and ends with a short packet.
    link.send(2, &[2, 9, !9, 0, 64, 0, 0, 0, 0, 0, 0, 0], LIMIT).await.unwrap();
    assert_eq!(link.control_in(class(0xA2, 3, 8, 0x82), 2, LIMIT).await.unwrap(), [0x81, 9]);
    assert_eq!(link.control_in(class(0xA2, 3, 9, 0x82), 2, LIMIT).await.unwrap(), [1, 9]);
    assert_eq!(link.read(0x82, 64, LIMIT).await.unwrap(), b"");
    assert_eq!(link.control_in(class(0xA2, 4, 0, 0x82), 8, LIMIT).await.unwrap()[0], 1);
    assert_eq!(link.control_in(class(0xA2, 3, 9, 0x82), 2, LIMIT).await.unwrap(), [0x80, 0]);
    // A clear is pending once, then done; what waited is gone.
    link.send(2, b"\x01\x01\xFE\x00\x06\x00\x00\x00\x01\x00\x00\x00*IDN?\n\x00\x00", LIMIT).await.unwrap();
    assert_eq!(link.control_in(class(0xA1, 5, 0, 0), 1, LIMIT).await.unwrap(), [1]);
    assert_eq!(link.control_in(class(0xA1, 6, 0, 0), 2, LIMIT).await.unwrap(), [2, 0]);
    assert_eq!(link.control_in(class(0xA1, 6, 0, 0), 2, LIMIT).await.unwrap(), [1, 0]);
    assert_eq!(
        link.control_in(class(0xA1, 128, 2, 0), 3, LIMIT).await.unwrap(),
        [1, 2, 4],
        "the error queue holds one"
    );
    assert_eq!(link.control_in(class(0xA1, 99, 0, 0), 3, LIMIT).await, Err(UsbError::Stall));
    // A header that is none halts the endpoint until it is cleared.
    assert_eq!(link.send(2, &[1, 5, 5, 0, 0, 0, 0, 0, 1, 0, 0, 0], LIMIT).await, Err(UsbError::Stall));
    assert_eq!(ask_halted(&mut link).await, Err(UsbError::Stall));
    link.clear_halt(2).await.unwrap();
    assert!(ask(&mut link, "*IDN?", 255).await.is_some());
}

async fn ask_halted(link: &mut UsbLink) -> Result<(), UsbError> {
    link.send(2, b"\x01\x01\xFE\x00\x06\x00\x00\x00\x01\x00\x00\x00*IDN?\n\x00\x00", LIMIT).await
}

#[tokio::test(start_paused = true)]
async fn a_wait_that_finds_nothing_lasts_as_long_as_its_limit() {
    let (bus, mut link) = ocean(OceanModel::Usb2000).await;
    let begin = Instant::now();
    assert_eq!(link.read(0x87, 64, LIMIT).await, Err(UsbError::Timeout));
    assert_eq!(begin.elapsed(), LIMIT);
    bus.unplug_for(Duration::from_millis(100));
    assert_eq!(link.read(0x87, 64, LIMIT).await, Err(UsbError::Gone));
    tokio::time::sleep(LIMIT).await;
    assert_eq!(link.read(0x87, 64, LIMIT).await, Err(UsbError::Gone), "a handle does not outlive its device");
}
