//! Targets: the words on the wires, each read and written back.

use super::harness::Target;
use goniod_drivers::devices::oceanoptics_protocol::{Layout, MODELS, Model, SYNC, slot_bytes, slot_number, slot_text};
use goniod_drivers::devices::zaber_protocol::{self, Address, Message};
use goniod_drivers::devices::zaber_warning::Warning;
use goniod_drivers::devices::{esp301_protocol, smc100_protocol, usbtmc};
use goniod_drivers::transport::usb::UsbAddress;

/// All of them.
pub const TARGETS: &[Target] = &[
    Target { name: "zaber-packet", run: zaber_packet, mutations: 6000 },
    Target { name: "zaber-warnings", run: zaber_warnings, mutations: 4000 },
    Target { name: "esp301-line", run: esp301_line, mutations: 6000 },
    Target { name: "smc100-line", run: smc100_line, mutations: 6000 },
    Target { name: "usbtmc-answer", run: usbtmc_answer, mutations: 6000 },
    Target { name: "ocean-answer", run: ocean_answer, mutations: 1500 },
    Target { name: "usb-address", run: usb_address, mutations: 4000 },
    #[cfg(feature = "aravis")]
    Target { name: "camera-pixels", run: camera_pixels, mutations: 3000 },
];

fn same<T: PartialEq + std::fmt::Debug>(what: &str, read: T, written: T) -> Result<(), String> {
    if read == written { Ok(()) } else { Err(format!("{what}: {read:?} was read, {written:?} is what it says")) }
}

fn text(bytes: &[u8]) -> std::borrow::Cow<'_, str> {
    String::from_utf8_lossy(bytes)
}

/// First byte: 1 where checksums are on. What is taken for a message writes itself as the bytes that came.
fn zaber_packet(bytes: &[u8]) -> Result<(), String> {
    let Some((flag, line)) = bytes.split_first() else { return Ok(()) };
    let checked = flag & 1 == 1;
    let Ok(message) = zaber_protocol::parse(line, checked) else { return Ok(()) };
    let head = |kind: char, at: Address, id: Option<u8>| {
        let id = id.map_or(String::new(), |id| format!(" {id:02}"));
        format!("{kind}{:02} {}{id}", at.device, at.axis)
    };
    let written = match message {
        Message::Reply(r) => {
            let (flag, busy) = (if r.accepted { "OK" } else { "RJ" }, if r.busy { "BUSY" } else { "IDLE" });
            format!("{} {flag} {busy} {} {}", head('@', r.at, r.id), r.warning, r.data)
        }
        Message::Info(at, id, words) => format!("{} {words}", head('#', at, id)),
        Message::Alert(at, words) => format!("{} {words}", head('!', at, None)),
    };
    // A blank after the last word carries nothing.
    let whole = |body: &str| {
        let sum = zaber_protocol::lrc(body.get(1..).unwrap_or_default().as_bytes());
        let summed = format!("{body}:{sum:02X}").into_bytes();
        (line == body.as_bytes() && !checked) || (if checked { line.ends_with(&summed) } else { line == summed })
    };
    if whole(&written) || whole(written.trim_end_matches(' ')) || whole(&format!("{written} ")) {
        return Ok(());
    }
    Err(format!("it is read as {written:?}"))
}

fn zaber_warnings(bytes: &[u8]) -> Result<(), String> {
    let text = text(bytes);
    let Some(list) = Warning::list(&text) else { return Ok(()) };
    let mut words = text.split_ascii_whitespace();
    let count = words.next().unwrap_or_default();
    if !count.bytes().all(|b| b.is_ascii_digit()) {
        return Err(format!("{count:?} is taken for a count"));
    }
    same("codes", list.iter().map(|w| w.code.clone()).collect(), words.map(str::to_owned).collect::<Vec<_>>())
}

fn esp301_line(bytes: &[u8]) -> Result<(), String> {
    let line = text(bytes);
    if let Some(report) = esp301_protocol::Report::parse(&line) {
        let code = line.split(',').next().unwrap_or_default().trim();
        same(
            "code",
            report.0.to_string(),
            code.trim_start_matches('0').to_owned() + if report.0 == 0 { "0" } else { "" },
        )?;
        let _ = (report.axis(), report.meaning(), report.concerns_all());
    }
    if let Some((model, serial)) = esp301_protocol::stage_id(&line)
        && (!line.contains(&model) || !line.contains(&serial))
    {
        return Err(format!("{model:?}, {serial:?} were read"));
    }
    Ok(())
}

/// First byte: the address that is asked.
fn smc100_line(bytes: &[u8]) -> Result<(), String> {
    use smc100_protocol::{Query, Status};
    let Some((&address, line)) = bytes.split_first() else { return Ok(()) };
    let line = text(line);
    for query in [Query::State, Query::Error, Query::Position, Query::StageId, Query::Velocity, Query::HomeLimit] {
        if let Some(value) = query.value(address, &line) {
            let head = format!("{address}{}", query.words().trim_end_matches('?'));
            same(
                "reply",
                line.trim_end().to_owned(),
                format!("{head}{}", line.trim_end().get(head.len()..).unwrap_or("")),
            )?;
            if let Some(status) = Status::parse(&value) {
                same("errors", format!("{:04X}", status.errors), value.get(..4).unwrap_or("").to_ascii_uppercase())?;
                let _ = status.words();
            }
        }
    }
    line.chars().next().map(smc100_protocol::meaning);
    Ok(())
}

/// First byte: the tag of the read; second: how many bytes it asked for.
fn usbtmc_answer(bytes: &[u8]) -> Result<(), String> {
    let [tag, most, answer @ ..] = bytes else { return Ok(()) };
    let Ok(part) = usbtmc::part(answer, *tag, usize::from(*most)) else { return Ok(()) };
    let mut written = vec![2, *tag, !*tag, 0];
    written.extend((part.data.len() as u32).to_le_bytes());
    // Bit 1 (ended by the terminator) says nothing that is kept.
    written.extend([u8::from(part.end) | answer.get(8).copied().unwrap_or(0) & 2, 0, 0, 0]);
    written.extend(&part.data);
    if part.data.len() > usize::from(*most) {
        return Err("more than was asked for is taken".to_owned());
    }
    same("answer", answer.get(..written.len()).unwrap_or_default(), written.as_slice())
}

/// First byte: the model; second: the slot that is asked.
fn ocean_answer(bytes: &[u8]) -> Result<(), String> {
    let [model, slot, answer @ ..] = bytes else { return Ok(()) };
    let model = &MODELS[usize::from(*model) % MODELS.len()];
    if let Some(body) = slot_bytes(answer, *slot) {
        same("slot", answer, [&[0x05, *slot], body].concat().as_slice())?;
        if slot_text(body).is_some_and(str::is_empty) || slot_number(body).is_some_and(|n| !n.is_finite()) {
            return Err("an empty text or no number is taken".to_owned());
        }
    }
    if let Some(status) = model.status(answer) {
        let time = status.time.to_le_bytes();
        let said = answer.get(2..6).unwrap_or_default();
        let fits = match model.layout {
            Layout::Interleaved => said.starts_with(&time[..2]) || said.starts_with(&[time[1], time[0]]),
            Layout::Words => said == &time[..4],
        };
        same("integration time", fits, true)?;
    }
    match model.counts(answer) {
        Some(counts) => same("spectrum", unmasked(model, answer), spectrum(model, &counts)),
        None => Ok(()),
    }
}

/// The bytes with which a model sends these counts.
fn spectrum(model: &Model, counts: &[u16]) -> Vec<u8> {
    let mut bytes: Vec<u8> = match model.layout {
        Layout::Words => counts.iter().flat_map(|c| c.to_le_bytes()).collect(),
        Layout::Interleaved => counts
            .chunks(64)
            .flat_map(|c| {
                let half = |byte: usize| c.iter().map(move |v| v.to_le_bytes()[byte]);
                half(0).chain(half(1))
            })
            .collect(),
    };
    bytes.push(SYNC);
    bytes
}

/// The bytes without the four bits that a twelve-bit model leaves open.
fn unmasked(model: &Model, answer: &[u8]) -> Vec<u8> {
    let last = answer.len().saturating_sub(1);
    let open = |i: usize| model.layout == Layout::Interleaved && i != last && i % 128 >= 64;
    answer.iter().enumerate().map(|(i, &b)| if open(i) { b & 0x0F } else { b }).collect()
}

fn usb_address(bytes: &[u8]) -> Result<(), String> {
    match text(bytes).parse::<UsbAddress>() {
        Ok(address) => same("address", address.to_string().parse(), Ok(address)),
        Err(error) if error.message.is_empty() => Err("an error without words".to_owned()),
        Err(_) => Ok(()),
    }
}

/// First byte: the format; second: how many pixels are wanted.
#[cfg(feature = "aravis")]
fn camera_pixels(bytes: &[u8]) -> Result<(), String> {
    use goniod_drivers::devices::aravis::WireFormat;
    let [format, pixels, picture @ ..] = bytes else { return Ok(()) };
    let format = WireFormat::ALL[usize::from(*format) % WireFormat::ALL.len()];
    let pixels = usize::from(*pixels);
    let Some(read) = format.unpack(picture, pixels, None) else {
        return same("length", picture.len() < format.bytes(pixels), true);
    };
    same("pixels", read.len(), pixels)?;
    let levels: Vec<u16> = (0..pixels).map(|i| read.level(i)).collect();
    let again: Vec<u8> = match format {
        WireFormat::Mono8 | WireFormat::Bayer(_, 8) => levels.iter().map(|&l| l as u8).collect(),
        WireFormat::Mono12p => pairs(&levels, |a, b| [a as u8, (a >> 8) as u8 | (b << 4) as u8, (b >> 4) as u8]),
        WireFormat::Mono12Packed => {
            pairs(&levels, |a, b| [(a >> 4) as u8, (a & 15) as u8 | (b << 4) as u8, (b >> 4) as u8])
        }
        _ => levels.iter().flat_map(|l| l.to_le_bytes()).collect(),
    };
    let mut came = picture.get(..format.bytes(pixels)).unwrap_or_default().to_vec();
    if pixels % 2 == 1 && matches!(format, WireFormat::Mono12p | WireFormat::Mono12Packed) {
        // The upper half of the last byte belongs to no pixel.
        came.last_mut().into_iter().for_each(|b| *b &= 0x0F);
    }
    same("picture", came.as_slice(), again.get(..came.len()).unwrap_or_default())
}

#[cfg(feature = "aravis")]
fn pairs(levels: &[u16], pack: impl Fn(u16, u16) -> [u8; 3]) -> Vec<u8> {
    levels.chunks(2).flat_map(|c| pack(c[0], c.get(1).copied().unwrap_or(0))).collect()
}
