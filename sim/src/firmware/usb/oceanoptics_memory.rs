//! What a spectrometer is: model numbers of the data sheets, descriptors, and the slots of its EEPROM.

use crate::front::usb::{Descriptors, Speed};

/// Models the twin can be.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum OceanModel {
    /// USB2000: full speed, milliseconds, 12 bits in packets of low and high bytes.
    Usb2000,
    /// USB2000+: high speed, microseconds, 16-bit words.
    Usb2000Plus,
    /// USB4000: high speed, microseconds, 3840 words, the first 2048 bytes on an endpoint of their own.
    Usb4000,
}

/// Numbers of a model.
#[derive(Debug, Clone, Copy)]
pub(super) struct Figures {
    pub(super) product: u16,
    pub(super) name: &'static str,
    pub(super) pixels: usize,
    /// First pixel that sees light, and one past the last.
    pub(super) active: (usize, usize),
    /// Command OUT, query IN, spectrum IN, and the fourth endpoint of the sheet.
    pub(super) endpoints: [u8; 4],
    pub(super) packet: usize,
    pub(super) full: u16,
}

// === impl OceanModel ===

impl OceanModel {
    pub(super) fn figures(self) -> Figures {
        match self {
            OceanModel::Usb2000 => Figures {
                product: 0x1002,
                name: "USB2000",
                pixels: 2048,
                active: (24, 2048),
                endpoints: [0x02, 0x87, 0x82, 0x07],
                packet: 64,
                full: 4095,
            },
            OceanModel::Usb2000Plus => Figures {
                product: 0x101E,
                name: "USB2000+",
                pixels: 2048,
                active: (18, 2048),
                endpoints: [0x01, 0x81, 0x82, 0x86],
                packet: 512,
                full: 65_535,
            },
            OceanModel::Usb4000 => Figures {
                product: 0x1022,
                name: "USB4000",
                pixels: 3840,
                active: (18, 3669),
                endpoints: [0x01, 0x81, 0x82, 0x86],
                packet: 512,
                full: 65_535,
            },
        }
    }

    /// Descriptors of the model: one configuration, one vendor interface, four bulk endpoints.
    pub(super) fn descriptors(self) -> Descriptors {
        let f = self.figures();
        let [p0, p1] = f.product.to_le_bytes();
        let version = if self == OceanModel::Usb2000 { [0x10, 0x01] } else { [0x00, 0x02] };
        let mut device = vec![18, 1, version[0], version[1], 0, 0, 0, 64, 0x57, 0x24, p0, p1];
        device.extend([0x02, 0x00, 1, 2, 0, 1]);
        let mut configuration = vec![9, 2, 46, 0, 1, 1, 0, 0x80, 200];
        configuration.extend([9, 4, 0, 0, 4, 0xFF, 0, 0, 0]);
        for endpoint in f.endpoints {
            let [low, high] = (f.packet as u16).to_le_bytes();
            configuration.extend([7, 5, endpoint, 2, low, high, 0]);
        }
        let maker = match self {
            OceanModel::Usb2000 => "USB2000 2.41.3".to_owned(),
            _ => "Ocean Optics Inc.".to_owned(),
        };
        let speed = if self == OceanModel::Usb2000 { Speed::Full } else { Speed::High };
        Descriptors { device, configuration, strings: vec![maker, format!("Ocean Optics {}", f.name)], speed }
    }

    /// Slots 0 to 19 of a unit with this serial number.
    pub(super) fn slots(self, serial: &str) -> Vec<Vec<u8>> {
        let scale = match self {
            OceanModel::Usb4000 => ["3.456789E+02", "2.1500E-01", "-5.12E-06", "-6.1E-11"],
            _ => [" 345.6789", "0.3789", "-1.5432e-05", "-2.23e-09"],
        };
        let full = f64::from(self.figures().full);
        // Two per cent less at full scale than at the bottom.
        let linearity = ["1.0".to_owned(), format!("{:.4e}", -0.01 / full), format!("{:.4e}", -0.01 / full / full)];
        let mut slots: Vec<Vec<u8>> = vec![serial.into()];
        slots.extend(scale.map(|text| text.as_bytes().to_vec()));
        slots.push(b"0".to_vec());
        slots.extend(linearity.into_iter().map(String::into_bytes));
        slots.extend(std::iter::repeat_n(b"0.0".to_vec(), 5));
        slots.extend([b"7".to_vec(), b"3 25 25".to_vec(), b"A2L 3".to_vec()]);
        slots.resize(20, Vec::new());
        if self != OceanModel::Usb2000
            && let Some(slot) = slots.get_mut(17)
        {
            // Four reserved bytes, then the level of saturation: 62000.
            *slot = vec![0, 0, 0, 0, 0x30, 0xF2];
        }
        slots
    }
}
