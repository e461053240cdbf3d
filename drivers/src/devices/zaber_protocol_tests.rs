//! The sheet's worked exchanges, byte for byte, and what noise does to them.
#![allow(clippy::unwrap_used, clippy::expect_used)]

use super::*;
use proptest::prelude::*;

fn at(device: u8, axis: u8) -> Address {
    Address { device, axis }
}

#[test]
fn checksums_are_those_of_the_manual() {
    assert_eq!(lrc(b"01 tools echo"), 0x8F);
    assert_eq!(lrc(b"1 1 04 get pos"), 0x28);
    assert_eq!(lrc(b"01 1 04 OK IDLE WR 0"), 0xB9);
}

#[test]
fn requests_are_the_worked_exchange() {
    let cases: [(Address, u8, Command, &str); 9] = [
        (at(1, 0), 0, Command::Get(Setting::DeviceId), "/1 0 00 get device.id:14\n"),
        (at(1, 0), 2, Command::Get(Setting::Version), "/1 0 02 get version:77\n"),
        (at(1, 1), 3, Command::Get(Setting::CycleDist), "/1 1 03 get limit.cycle.dist:3C\n"),
        (at(1, 1), 5, Command::Home, "/1 1 05 home:30\n"),
        (at(1, 1), 6, Command::Poll, "/1 1 06:F8\n"),
        (at(1, 1), 7, Command::MoveAbs(128_000), "/1 1 07 move abs 128000:7F\n"),
        (at(1, 1), 8, Command::Stop, "/1 1 08 stop:10\n"),
        (at(1, 1), 9, Command::MoveAbs(99_999_999), "/1 1 09 move abs 99999999:E0\n"),
        (at(1, 0), 10, Command::Warnings, "/1 0 10 warnings:75\n"),
    ];
    for (address, id, command, line) in cases {
        assert_eq!(String::from_utf8(encode(address, id, command)).unwrap(), line);
    }
}

#[test]
fn replies_are_the_worked_exchange() {
    let Ok(Message::Reply(reply)) = parse(b"@01 0 00 OK IDLE WR 50081:F0", true) else { panic!("not a reply") };
    assert_eq!((reply.at, reply.id, reply.accepted, reply.busy), (at(1, 0), Some(0), true, false));
    assert_eq!((reply.warning.as_str(), reply.data.as_str()), ("WR", "50081"));
    for line in [
        "@01 0 02 OK IDLE WR 7.38:1C",
        "@01 1 03 OK IDLE WR 1536000:8B",
        "@01 1 05 OK BUSY WR 0:93",
        "@01 1 06 OK BUSY -- 0:E1",
        "@01 1 06 OK IDLE -- 0:06",
        "@01 1 07 OK BUSY -- 0:E0",
        "@01 1 08 OK BUSY NI 0:A2",
        "@01 1 09 RJ IDLE -- BADDATA:50",
        "@01 0 10 OK IDLE WR 01 WR:C3",
    ] {
        assert!(matches!(parse(line.as_bytes(), true), Ok(Message::Reply(_))), "{line}");
    }
    assert_eq!(parse(b"!01 1 IDLE FS:57", true), Ok(Message::Alert(at(1, 1), "IDLE FS".into())));
    assert_eq!(parse(b"#01 0 04 cont 1 7 8", false), Ok(Message::Info(at(1, 0), Some(4), "cont 1 7 8".into())));
}

#[test]
fn a_line_that_fails_its_proof_is_no_message() {
    assert_eq!(parse(b"@01 1 06 OK IDLE -- 1:06", true), Err(Defect::Checksum));
    assert_eq!(parse(b"@01 1 06 OK IDLE -- 0", true), Err(Defect::NoChecksum));
    assert_eq!(parse(b"", false), Err(Defect::Shape));
    assert_eq!(parse(b"junk", false), Err(Defect::Shape));
    assert_eq!(parse(b"@1 1 06 OK IDLE -- 0", false), Err(Defect::Shape));
    assert!(matches!(parse(b"\x00~junk@01 1 06 OK IDLE -- 0:06", true), Ok(Message::Reply(_))));
}

#[test]
fn no_destructive_word_can_be_spelt() {
    let settings = [Setting::Checksum, Setting::Alert, Setting::Uptime, Setting::MaxSpeed, Setting::CycleDist];
    let commands = [
        Command::Poll,
        Command::Echo(1),
        Command::ChecksumOn,
        Command::AlertsOff,
        Command::SetMaxSpeed(1),
        Command::SetAccel(1),
        Command::DriverEnable,
        Command::Unpark,
        Command::Home,
        Command::MoveAbs(1),
        Command::Stop,
        Command::Warnings,
        Command::ClearWarnings,
    ];
    let words = commands.into_iter().chain(settings.map(Command::Get)).map(|c| c.to_string());
    for word in words {
        for bad in
            ["renumber", "address", "baud", "resolution", "peripheral.id", "restore", "storage", "reset", "estop"]
        {
            assert!(!word.contains(bad), "{word}");
        }
    }
}

proptest! {
    #[test]
    fn any_single_wrong_byte_is_seen(position in 1_usize..27, wrong in 1_u8..=255) {
        let mut line = b"@01 1 04 OK IDLE -- 384000:".to_vec();
        let sum = lrc(&line[1..line.len() - 1]);
        line.extend(format!("{sum:02X}").bytes());
        prop_assert!(parse(&line, true).is_ok());
        line[position] ^= wrong;
        let read = parse(&line, true);
        prop_assert!(!matches!(read, Ok(Message::Reply(_))), "{:?}", read);
    }

    #[test]
    fn no_line_makes_the_reader_panic(line in proptest::collection::vec(any::<u8>(), 0..300), checked: bool) {
        let _ = parse(&line, checked);
    }
}
