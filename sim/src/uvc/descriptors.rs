//! What the camera says of itself: USB and UVC 1.0 descriptors, one bulk endpoint, one discrete size a format.
//!
//! Source: USB Device Class Definition for Video Devices 1.0 (descriptors of chapters 3.7 to 3.9).

use super::mode::Mode;
use crate::front::usb::{Descriptors, Speed};

/// Endpoint of the pictures.
pub const STREAM: u8 = 0x81;
/// Number of the control interface.
pub const CONTROL_INTERFACE: u8 = 0;
/// Number of the streaming interface.
pub const STREAM_INTERFACE: u8 = 1;
/// Camera terminal.
pub const CAMERA: u8 = 1;
/// Processing unit.
pub const PROCESSING: u8 = 2;
/// Output terminal.
const OUTPUT: u8 = 3;
/// Shortest frame interval in 100 ns.
pub const SHORTEST_INTERVAL: u32 = 333_333;
/// Longest frame interval in 100 ns.
pub const LONGEST_INTERVAL: u32 = 150_000_000;

/// Class-specific interface descriptor.
const CS_INTERFACE: u8 = 0x24;

/// All descriptors of a camera with these modes and this serial number.
pub fn descriptors(modes: &[Mode], serial: &str) -> Descriptors {
    // Test ids of pid.codes; miscellaneous class with interface association.
    let device = vec![18, 1, 0, 2, 0xef, 2, 1, 64, 0x09, 0x12, 0x01, 0x00, 0x00, 0x01, 1, 2, 3, 1];
    let mut body = vec![8, 0x0b, CONTROL_INTERFACE, 2, 0x0e, 3, 0, 2];
    body.extend(control_interface());
    body.extend(stream_interface(modes));
    let total = 9 + body.len() as u16;
    let mut configuration = vec![9, 2];
    configuration.extend(total.to_le_bytes());
    configuration.extend([2, 1, 0, 0xc0, 0]);
    configuration.extend(body);
    let strings = vec!["goniod-sim".to_owned(), "Colour CCD twin".to_owned(), serial.to_owned()];
    Descriptors { device, configuration, strings, speed: Speed::High }
}

fn control_interface() -> Vec<u8> {
    let mut units = Vec::new();
    // Camera terminal: automatic exposure mode, its priority, exposure time (absolute).
    units.extend([18, CS_INTERFACE, 2, CAMERA, 0x01, 0x02, 0, 0, 0, 0, 0, 0, 0, 0, 3, 0x0e, 0, 0]);
    // Processing unit: brightness, gamma, gain.
    units.extend([11, CS_INTERFACE, 5, PROCESSING, CAMERA, 0, 0, 2, 0x21, 0x02, 0]);
    units.extend([9, CS_INTERFACE, 3, OUTPUT, 0x01, 0x01, 0, PROCESSING, 0]);
    let mut out = vec![9, 4, CONTROL_INTERFACE, 0, 0, 0x0e, 1, 0, 2];
    out.extend([13, CS_INTERFACE, 1, 0x00, 0x01]);
    out.extend((13 + units.len() as u16).to_le_bytes());
    out.extend(1_000_000_u32.to_le_bytes());
    out.extend([1, STREAM_INTERFACE]);
    out.extend(units);
    out
}

fn stream_interface(modes: &[Mode]) -> Vec<u8> {
    let mut formats = Vec::new();
    for (index, mode) in (1_u8..).zip(modes) {
        formats.extend(format(index, mode));
        formats.extend(frame(mode));
        // Colour matching: BT.709 primaries, linear transfer, SMPTE 170M matrix.
        formats.extend([6, CS_INTERFACE, 0x0d, 1, 6, 4]);
    }
    let header = 13 + modes.len();
    let mut out = vec![9, 4, STREAM_INTERFACE, 0, 1, 0x0e, 2, 0, 0];
    out.extend([header as u8, CS_INTERFACE, 1, modes.len() as u8]);
    out.extend(((header + formats.len()) as u16).to_le_bytes());
    out.extend([STREAM, 0, OUTPUT, 0, 0, 0, 1]);
    out.resize(out.len() + modes.len(), 0);
    out.extend(formats);
    out.extend([7, 5, STREAM, 2, 0x00, 0x02, 0]);
    out
}

fn format(index: u8, mode: &Mode) -> Vec<u8> {
    let mut out = vec![27, CS_INTERFACE, 4, index, 1];
    out.extend(mode.format.code());
    // The rest of the GUID is the same for every four-character code.
    out.extend([0, 0, 0x10, 0, 0x80, 0, 0, 0xaa, 0, 0x38, 0x9b, 0x71]);
    out.extend([8 * mode.format.bytes_per_pixel() as u8, 1, 0, 0, 0, 0]);
    out
}

fn frame(mode: &Mode) -> Vec<u8> {
    let bytes = mode.bytes() as u32;
    let mut out = vec![38, CS_INTERFACE, 5, 1, 0];
    out.extend(mode.width.to_le_bytes());
    out.extend(mode.height.to_le_bytes());
    for value in [bytes, bytes.saturating_mul(240), bytes, SHORTEST_INTERVAL] {
        out.extend(value.to_le_bytes());
    }
    // Any interval between the two.
    out.push(0);
    for value in [SHORTEST_INTERVAL, LONGEST_INTERVAL, 1] {
        out.extend(value.to_le_bytes());
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::front::usbip::standard::parts;

    #[test]
    fn lengths_add_up_over_the_whole_configuration() {
        let modes = Mode::ALL;
        let all = descriptors(&modes, "SN42");
        let walked: usize = parts(&all.configuration).map(<[u8]>::len).sum();
        assert_eq!(walked, all.configuration.len());
        assert_eq!(all.configuration[2..4], (walked as u16).to_le_bytes());
        let totals: Vec<(usize, u16)> = parts(&all.configuration)
            .filter(|d| d[1] == CS_INTERFACE && d[2] == 1)
            .map(|d| {
                (d.len(), u16::from_le_bytes(if d[0] == 13 && d[3..5] == [0, 1] { [d[5], d[6]] } else { [d[4], d[5]] }))
            })
            .collect();
        let of = |from: usize, to: usize| -> usize {
            parts(&all.configuration).skip(from).take(to - from).map(<[u8]>::len).sum()
        };
        // Header, camera, processing, output; header and three descriptors a mode.
        assert_eq!(usize::from(totals[0].1), of(3, 7));
        assert_eq!(usize::from(totals[1].1), of(8, 9 + 3 * modes.len()));
    }
}
