//! The twin's register file: power-up values, who may write what, and what a write sets off.

use super::address as a;
use super::pixel::PixelCode;
use super::xml;
use std::net::Ipv4Addr;

/// GVCP status codes the twin gives.
pub mod status {
    /// Request not known.
    pub const NOT_IMPLEMENTED: u16 = 0x8001;
    /// Value out of range.
    pub const INVALID_PARAMETER: u16 = 0x8002;
    /// No register there.
    pub const INVALID_ADDRESS: u16 = 0x8003;
    /// Read-only register, or locked while acquiring.
    pub const WRITE_PROTECT: u16 = 0x8004;
    /// Address not a multiple of four.
    pub const BAD_ALIGNMENT: u16 = 0x8005;
    /// Another controls the camera, or nobody does.
    pub const ACCESS_DENIED: u16 = 0x8006;
    /// Stream packet is gone for good.
    pub const PACKET_UNAVAILABLE: u16 = 0x800c;
}

/// The sensor behind the registers.
#[derive(Debug, Clone, PartialEq)]
pub struct Sensor {
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Shortest integration time in microseconds.
    pub shortest_us: f64,
    /// Longest integration time in microseconds.
    pub longest_us: f64,
    /// Highest frame rate.
    pub max_fps: f64,
    /// Format after power-up.
    pub format: PixelCode,
    /// Sensor temperature in degrees Celsius.
    pub temperature_c: f64,
}

/// What a write sets off beyond the value itself.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Effect {
    /// Nothing.
    None,
    /// Acquisition starts.
    Start,
    /// Acquisition stops.
    Stop,
    /// One frame is triggered.
    Trigger,
    /// A test packet goes out.
    TestPacket,
    /// The time stamp is latched.
    Latch,
    /// The camera restarts.
    Reset,
}

/// The registers.
#[derive(Debug)]
pub struct Registers {
    file: Vec<u8>,
    xml: Vec<u8>,
    sensor: Sensor,
    chunks: [bool; 3],
    /// Acquisition runs: format and size are locked.
    pub acquiring: bool,
}

/// Registers that nobody may write (first address, end).
const READ_ONLY: [(u32, u32); 8] = [
    (0, a::USER_NAME),
    (a::DISCOVERY_END, a::HEARTBEAT_MS),
    (a::TICK_HIGH, a::STAMP_CONTROL),
    (a::STAMP_HIGH, a::PRIVILEGE),
    (a::PAYLOAD_SIZE, a::ACQUISITION_MODE),
    (a::TEMPERATURE, a::CHUNK_ACTIVE),
    (a::STREAM_SOURCE, a::STREAM_SOURCE + 4),
    (a::END, u32::MAX),
];

// === impl Sensor ===

impl Default for Sensor {
    fn default() -> Sensor {
        Sensor {
            width: 320,
            height: 256,
            shortest_us: 20.0,
            longest_us: 120e6,
            max_fps: 1000.0,
            format: PixelCode::Mono12,
            temperature_c: -12.5,
        }
    }
}

// === impl Registers ===

impl Registers {
    /// The registers as they stand after power-up: free running, automatic exposure and gain on, no chunks.
    pub fn power_up(sensor: &Sensor, serial: &str, ip: Ipv4Addr) -> Registers {
        let description = xml::describe(sensor).into_bytes();
        let mut r = Registers {
            file: vec![0; a::END as usize],
            xml: description,
            sensor: sensor.clone(),
            chunks: [false; 3],
            acquiring: false,
        };
        r.put(0, 0x0001_0002);
        r.put(a::DEVICE_MODE, 0x8000_0001);
        r.put(a::MAC_LOW, u32::from(ip) | 0x0200_0000);
        r.put(a::IP_OPTIONS, 0x7);
        r.put(a::IP_CONFIG, 0x5);
        r.put(a::IP, u32::from(ip));
        r.put(a::MASK, 0xff00_0000);
        r.put_text(a::VENDOR, "goniod", 32);
        r.put_text(a::MODEL, "GigeTwin", 32);
        r.put_text(a::VERSION, "1.0", 32);
        r.put_text(a::INFO, "camera of the simulated bench", 48);
        r.put_text(a::SERIAL, serial, 16);
        let url = format!("Local:goniod_twin.xml;{:x};{:x}", a::XML, r.xml.len());
        r.put_text(a::XML_URL, &url, 512);
        r.put(a::INTERFACES, 1);
        r.put(a::STREAM_CHANNELS, 1);
        r.put(a::CAPABILITY, 0x7);
        r.put(a::HEARTBEAT_MS, 3000);
        r.put(a::TICK_HIGH + 4, 1_000_000_000);
        r.put(a::PACKET_SIZE, 1400);
        r.put(a::WIDTH, sensor.width);
        r.put(a::HEIGHT, sensor.height);
        r.put(a::SENSOR_WIDTH, sensor.width);
        r.put(a::SENSOR_HEIGHT, sensor.height);
        r.put(a::PIXEL_FORMAT, sensor.format.code());
        r.put_f64(a::FRAME_RATE, 25.0_f64.min(sensor.max_fps));
        r.put(a::FRAME_RATE_ENABLE, 1);
        r.put_f64(a::EXPOSURE, 10_000.0);
        r.put(a::EXPOSURE_AUTO, 2);
        r.put_f64(a::GAIN, 6.0);
        r.put(a::GAIN_AUTO, 2);
        r.put_f64(a::TEMPERATURE, sensor.temperature_c);
        r.put(a::COOLER, 2);
        r.settle();
        r
    }

    /// A 32-bit register.
    pub fn get(&self, address: u32) -> u32 {
        let i = address as usize;
        self.file.get(i..i + 4).and_then(|b| b.try_into().ok()).map_or(0, u32::from_be_bytes)
    }

    /// A double register.
    pub fn get_f64(&self, address: u32) -> f64 {
        f64::from_bits(u64::from(self.get(address)) << 32 | u64::from(self.get(address + 4)))
    }

    /// Sets a 32-bit register, whatever the access rules say.
    pub fn put(&mut self, address: u32, value: u32) {
        let i = address as usize;
        if let Some(bytes) = self.file.get_mut(i..i + 4) {
            bytes.copy_from_slice(&value.to_be_bytes());
        }
    }

    /// Sets a double register, whatever the access rules say.
    pub fn put_f64(&mut self, address: u32, value: f64) {
        self.put(address, (value.to_bits() >> 32) as u32);
        self.put(address + 4, value.to_bits() as u32);
    }

    fn put_text(&mut self, address: u32, text: &str, room: usize) {
        let i = address as usize;
        let n = text.len().min(room - 1);
        if let (Some(bytes), Some(text)) = (self.file.get_mut(i..i + n), text.as_bytes().get(..n)) {
            bytes.copy_from_slice(text);
        }
    }

    /// The pixel format in force.
    pub fn format(&self) -> PixelCode {
        PixelCode::from_code(self.get(a::PIXEL_FORMAT)).unwrap_or(self.sensor.format)
    }

    /// Which chunks are sent: integration time, time stamp, frame id; none while chunk mode is off.
    pub fn chunks(&self) -> [bool; 3] {
        if self.get(a::CHUNK_ACTIVE) == 1 { self.chunks } else { [false; 3] }
    }

    /// Bytes at an address: register file or XML.
    ///
    /// # Errors
    /// A GVCP status: [`status::BAD_ALIGNMENT`] or [`status::INVALID_ADDRESS`].
    pub fn read(&self, address: u32, count: usize) -> Result<Vec<u8>, u16> {
        if !address.is_multiple_of(4) {
            return Err(status::BAD_ALIGNMENT);
        }
        let (store, start) = match address.checked_sub(a::XML) {
            Some(offset) => (&self.xml, offset as usize),
            None => (&self.file, address as usize),
        };
        let padded = store.len().next_multiple_of(4);
        if start + count > padded {
            return Err(status::INVALID_ADDRESS);
        }
        let mut bytes = store.get(start..(start + count).min(store.len())).unwrap_or_default().to_vec();
        bytes.resize(count, 0);
        Ok(bytes)
    }

    /// Writes bytes by the access rules and says what that sets off. Privilege is not decided here.
    ///
    /// # Errors
    /// A GVCP status: read-only, locked while acquiring, out of range, no such register.
    pub fn write(&mut self, address: u32, bytes: &[u8]) -> Result<Effect, u16> {
        if !address.is_multiple_of(4) || !bytes.len().is_multiple_of(4) {
            return Err(status::BAD_ALIGNMENT);
        }
        if READ_ONLY.iter().any(|(first, end)| (*first..*end).contains(&address)) {
            return Err(status::WRITE_PROTECT);
        }
        if self.acquiring && [a::WIDTH, a::HEIGHT, a::PIXEL_FORMAT, a::CHUNK_ACTIVE, a::CHUNK_ENABLE].contains(&address)
        {
            return Err(status::WRITE_PROTECT);
        }
        let i = address as usize;
        let before = self.file.get(i..i + bytes.len()).ok_or(status::INVALID_ADDRESS)?.to_vec();
        if let Some(place) = self.file.get_mut(i..i + bytes.len()) {
            place.copy_from_slice(bytes);
        }
        if !self.in_range(address) {
            if let Some(place) = self.file.get_mut(i..i + before.len()) {
                place.copy_from_slice(&before);
            }
            return Err(status::INVALID_PARAMETER);
        }
        Ok(self.effect(address))
    }

    fn in_range(&self, address: u32) -> bool {
        let within = |value: f64, low: f64, high: f64| (low..=high).contains(&value);
        match address {
            a::EXPOSURE => within(self.get_f64(address), self.sensor.shortest_us, self.sensor.longest_us),
            a::FRAME_RATE => within(self.get_f64(address), 0.01, self.sensor.max_fps),
            a::GAIN => within(self.get_f64(address), 0.0, 24.0),
            a::WIDTH => (32..=self.sensor.width).contains(&self.get(address)) && self.get(address).is_multiple_of(4),
            a::HEIGHT => (4..=self.sensor.height).contains(&self.get(address)) && self.get(address).is_multiple_of(4),
            a::PIXEL_FORMAT => PixelCode::from_code(self.get(address)).is_some(),
            a::CHUNK_SELECTOR => self.get(address) < 3,
            _ => true,
        }
    }

    fn effect(&mut self, address: u32) -> Effect {
        match address {
            a::EXPOSURE => self.put_f64(address, self.get_f64(address).round()),
            a::CHUNK_SELECTOR => {
                let on = self.chunks.get(self.get(address) as usize).copied().unwrap_or(false);
                self.put(a::CHUNK_ENABLE, u32::from(on));
            }
            a::CHUNK_ENABLE => {
                let on = self.get(address) == 1;
                let selected = self.get(a::CHUNK_SELECTOR) as usize;
                if let Some(chunk) = self.chunks.get_mut(selected) {
                    *chunk = on;
                }
            }
            a::TEMPERATURE_SELECTOR => {
                let board = if self.get(address) == 1 { 45.0 } else { 0.0 };
                self.put_f64(a::TEMPERATURE, self.sensor.temperature_c + board);
            }
            a::ACQUISITION_START => return Effect::Start,
            a::ACQUISITION_STOP => return Effect::Stop,
            a::TRIGGER_SOFTWARE => return Effect::Trigger,
            a::DEVICE_RESET => return Effect::Reset,
            a::STAMP_CONTROL if self.get(address) & 2 != 0 => return Effect::Latch,
            a::PACKET_SIZE if self.get(address) & 0x8000_0000 != 0 => {
                self.put(address, self.get(address) & 0x7fff_ffff);
                return Effect::TestPacket;
            }
            _ => {}
        }
        self.settle();
        Effect::None
    }

    /// Values that follow from others.
    fn settle(&mut self) {
        let pixels = self.get(a::WIDTH) as usize * self.get(a::HEIGHT) as usize;
        let chunks = self.chunks().iter().filter(|on| **on).count();
        let trailer = if self.get(a::CHUNK_ACTIVE) == 1 { 8 + chunks * 16 } else { 0 };
        self.put(a::PAYLOAD_SIZE, (self.format().bytes(pixels) + trailer) as u32);
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used)]
    use super::*;

    fn registers() -> Registers {
        Registers::power_up(&Sensor::default(), "T1", Ipv4Addr::new(127, 0, 0, 9))
    }

    #[test]
    fn exposure_is_kept_in_whole_microseconds_and_within_the_sensors_range() {
        let mut r = registers();
        assert_eq!(r.write(a::EXPOSURE, &4100.4_f64.to_be_bytes()), Ok(Effect::None));
        assert_eq!(r.get_f64(a::EXPOSURE), 4100.0);
        assert_eq!(r.write(a::EXPOSURE, &1e12_f64.to_be_bytes()), Err(status::INVALID_PARAMETER));
        assert_eq!(r.get_f64(a::EXPOSURE), 4100.0, "a refused value leaves the old one");
    }

    #[test]
    fn read_only_and_locked_registers_refuse() {
        let mut r = registers();
        assert_eq!(r.write(a::SENSOR_WIDTH, &[0; 4]), Err(status::WRITE_PROTECT));
        assert_eq!(r.write(a::SERIAL, &[0; 4]), Err(status::WRITE_PROTECT));
        r.acquiring = true;
        assert_eq!(r.write(a::WIDTH, &64_u32.to_be_bytes()), Err(status::WRITE_PROTECT));
        assert_eq!(r.write(a::EXPOSURE, &100.0_f64.to_be_bytes()), Ok(Effect::None), "exposure changes while running");
    }

    #[test]
    fn payload_follows_format_and_chunks() {
        let mut r = registers();
        assert_eq!(r.get(a::PAYLOAD_SIZE), 320 * 256 * 2);
        r.write(a::PIXEL_FORMAT, &PixelCode::Mono12p.code().to_be_bytes()).unwrap();
        r.write(a::CHUNK_ACTIVE, &1_u32.to_be_bytes()).unwrap();
        r.write(a::CHUNK_ENABLE, &1_u32.to_be_bytes()).unwrap();
        assert_eq!(r.get(a::PAYLOAD_SIZE), 320 * 256 * 3 / 2 + 8 + 16);
    }

    #[test]
    fn the_xml_is_read_to_its_last_byte_and_no_further() {
        let r = registers();
        let url = String::from_utf8(r.read(a::XML_URL, 64).unwrap()).unwrap();
        let length = usize::from_str_radix(url.trim_end_matches('\0').rsplit(';').next().unwrap(), 16).unwrap();
        let text = String::from_utf8(r.read(a::XML, length.next_multiple_of(4)).unwrap()).unwrap();
        assert!(text.trim_end_matches('\0').ends_with("</RegisterDescription>\n"));
        assert_eq!(r.read(a::XML, length + 8), Err(status::INVALID_ADDRESS));
    }
}
