//! The twin's GenICam description: SFNC names over the registers of [`super::address`], made from a table.

use super::address as a;
use super::pixel::PixelCode;
use super::registers::Sensor;
use std::fmt::Write;

/// Chunk ids: image, integration time, time stamp, frame id.
pub const CHUNK_IDS: [u32; 4] = [0x0001, 0x1001, 0x1002, 0x1003];

struct Description(String);

// === impl Description ===

impl Description {
    fn register(&mut self, kind: &str, name: &str, address: u32, length: u32, access: &str, port: &str) {
        let sign = if kind == "IntReg" { "<Sign>Unsigned</Sign>" } else { "" };
        let end = if kind == "StringReg" { "" } else { "<Endianess>BigEndian</Endianess>" };
        let _ = writeln!(
            self.0,
            "<{kind} Name=\"{name}\"><Address>0x{address:x}</Address><Length>{length}</Length><AccessMode>{access}</AccessMode><pPort>{port}</pPort><Cachable>NoCache</Cachable>{sign}{end}</{kind}>"
        );
    }

    fn integer(&mut self, name: &str, address: u32, access: &str, range: (i64, i64, i64)) {
        let (min, max, inc) = range;
        let _ = writeln!(
            self.0,
            "<Integer Name=\"{name}\" NameSpace=\"Standard\"><pValue>{name}Register</pValue><Min>{min}</Min><Max>{max}</Max><Inc>{inc}</Inc></Integer>"
        );
        self.register("IntReg", &format!("{name}Register"), address, 4, access, "Device");
    }

    fn float(&mut self, name: &str, address: u32, access: &str, range: (f64, f64), unit: &str) {
        let (min, max) = range;
        let _ = writeln!(
            self.0,
            "<Float Name=\"{name}\" NameSpace=\"Standard\"><pValue>{name}Register</pValue><Min>{min}</Min><Max>{max}</Max><Unit>{unit}</Unit></Float>"
        );
        self.register("FloatReg", &format!("{name}Register"), address, 8, access, "Device");
    }

    fn boolean(&mut self, name: &str, address: u32) {
        let _ = writeln!(
            self.0,
            "<Boolean Name=\"{name}\" NameSpace=\"Standard\"><pValue>{name}Register</pValue><OnValue>1</OnValue><OffValue>0</OffValue></Boolean>"
        );
        self.register("IntReg", &format!("{name}Register"), address, 4, "RW", "Device");
    }

    fn command(&mut self, name: &str, address: u32, value: u32) {
        let _ = writeln!(
            self.0,
            "<Command Name=\"{name}\" NameSpace=\"Standard\"><pValue>{name}Register</pValue><CommandValue>{value}</CommandValue></Command>"
        );
        self.register("IntReg", &format!("{name}Register"), address, 4, "WO", "Device");
    }

    fn choice(&mut self, name: &str, address: u32, access: &str, entries: &[(&str, u32)], selects: &[&str]) {
        let _ = write!(self.0, "<Enumeration Name=\"{name}\" NameSpace=\"Standard\">");
        for (entry, value) in entries {
            let _ =
                write!(self.0, "<EnumEntry Name=\"{entry}\" NameSpace=\"Standard\"><Value>{value}</Value></EnumEntry>");
        }
        let _ = write!(self.0, "<pValue>{name}Register</pValue>");
        for selected in selects {
            let _ = write!(self.0, "<pSelected>{selected}</pSelected>");
        }
        let _ = writeln!(self.0, "</Enumeration>");
        self.register("IntReg", &format!("{name}Register"), address, 4, access, "Device");
    }

    fn text(&mut self, name: &str, address: u32, length: u32, access: &str) {
        self.register("StringReg", name, address, length, access, "Device");
    }

    fn category(&mut self, name: &str, features: &[&str]) {
        let _ = write!(self.0, "<Category Name=\"{name}\" NameSpace=\"Standard\">");
        for feature in features {
            let _ = write!(self.0, "<pFeature>{feature}</pFeature>");
        }
        let _ = writeln!(self.0, "</Category>");
    }

    fn chunk(&mut self, name: &str, id: u32, float: bool) {
        let port = format!("{name}Port");
        let register = format!("{name}Register");
        let _ = writeln!(self.0, "<Port Name=\"{port}\"><ChunkID>{id:x}</ChunkID></Port>");
        if float {
            let _ =
                writeln!(self.0, "<Float Name=\"{name}\" NameSpace=\"Standard\"><pValue>{register}</pValue></Float>");
            self.register("FloatReg", &register, 0, 8, "RO", &port);
        } else {
            let _ = writeln!(
                self.0,
                "<Integer Name=\"{name}\" NameSpace=\"Standard\"><pValue>{register}</pValue></Integer>"
            );
            self.register("IntReg", &register, 0, 8, "RO", &port);
        }
    }
}

/// The whole description for a sensor.
pub fn describe(sensor: &Sensor) -> String {
    let mut d = Description(String::from(concat!(
        "<?xml version=\"1.0\" encoding=\"utf-8\"?>\n",
        "<RegisterDescription ModelName=\"GigeTwin\" VendorName=\"goniod\" ToolTip=\"Camera of the simulated bench\" ",
        "StandardNameSpace=\"GEV\" SchemaMajorVersion=\"1\" SchemaMinorVersion=\"1\" SchemaSubMinorVersion=\"0\" ",
        "MajorVersion=\"1\" MinorVersion=\"0\" SubMinorVersion=\"0\" ",
        "ProductGuid=\"6b0b1c0e-5a0e-4b5c-9d63-0c0f5a3f7a10\" VersionGuid=\"6b0b1c0e-5a0e-4b5c-9d63-0c0f5a3f7a11\" ",
        "xmlns=\"http://www.genicam.org/GenApi/Version_1_1\" ",
        "xmlns:xsi=\"http://www.w3.org/2001/XMLSchema-instance\" ",
        "xsi:schemaLocation=\"http://www.genicam.org/GenApi/Version_1_1 ",
        "http://www.genicam.org/GenApi/GenApiSchema_Version_1_1.xsd\">\n",
    )));
    categories(&mut d);
    identity(&mut d);
    image(&mut d, sensor);
    acquisition(&mut d, sensor);
    transport(&mut d);
    chunks(&mut d);
    d.0.push_str("<Port Name=\"Device\" NameSpace=\"Standard\"></Port>\n</RegisterDescription>\n");
    d.0
}

fn categories(d: &mut Description) {
    d.category(
        "Root",
        &[
            "DeviceControl",
            "ImageFormatControl",
            "AcquisitionControl",
            "AnalogControl",
            "ChunkDataControl",
            "TransportLayerControl",
        ],
    );
    d.category(
        "DeviceControl",
        &[
            "DeviceVendorName",
            "DeviceModelName",
            "DeviceVersion",
            "DeviceFirmwareVersion",
            "DeviceSerialNumber",
            "DeviceUserID",
            "DeviceReset",
            "DeviceTemperatureSelector",
            "DeviceTemperature",
            "SensorCoolerState",
        ],
    );
    d.category("ImageFormatControl", &["SensorWidth", "SensorHeight", "Width", "Height", "PixelFormat"]);
    d.category(
        "AcquisitionControl",
        &[
            "AcquisitionMode",
            "AcquisitionStart",
            "AcquisitionStop",
            "AcquisitionFrameRate",
            "AcquisitionFrameRateEnable",
            "ExposureMode",
            "ExposureTime",
            "ExposureAuto",
            "TriggerSelector",
            "TriggerMode",
            "TriggerSource",
            "TriggerSoftware",
        ],
    );
    d.category("AnalogControl", &["Gain", "GainAuto", "BlackLevel"]);
    d.category(
        "ChunkDataControl",
        &["ChunkModeActive", "ChunkSelector", "ChunkEnable", "ChunkExposureTime", "ChunkTimestamp", "ChunkFrameID"],
    );
    d.category(
        "TransportLayerControl",
        &[
            "PayloadSize",
            "TLParamsLocked",
            "GevHeartbeatTimeout",
            "GevTimestampControlLatch",
            "GevTimestampValue",
            "GevSCPSPacketSize",
            "GevSCPSFireTestPacket",
            "GevSCPSDoNotFragment",
            "GevSCPD",
        ],
    );
}

fn identity(d: &mut Description) {
    d.text("DeviceVendorName", a::VENDOR, 32, "RO");
    d.text("DeviceModelName", a::MODEL, 32, "RO");
    d.text("DeviceVersion", a::VERSION, 32, "RO");
    d.text("DeviceFirmwareVersion", a::VERSION, 32, "RO");
    d.text("DeviceSerialNumber", a::SERIAL, 16, "RO");
    d.text("DeviceUserID", a::USER_NAME, 16, "RW");
    d.command("DeviceReset", a::DEVICE_RESET, 1);
    let places = [("Sensor", 0), ("Mainboard", 1)];
    d.choice("DeviceTemperatureSelector", a::TEMPERATURE_SELECTOR, "RW", &places, &["DeviceTemperature"]);
    d.float("DeviceTemperature", a::TEMPERATURE, "RO", (-273.15, 200.0), "C");
    d.choice("SensorCoolerState", a::COOLER, "RO", &[("Off", 0), ("Settling", 1), ("Locked", 2)], &[]);
}

fn image(d: &mut Description, sensor: &Sensor) {
    let (width, height) = (i64::from(sensor.width), i64::from(sensor.height));
    d.integer("SensorWidth", a::SENSOR_WIDTH, "RO", (1, width, 1));
    d.integer("SensorHeight", a::SENSOR_HEIGHT, "RO", (1, height, 1));
    d.integer("Width", a::WIDTH, "RW", (32, width, 4));
    d.integer("Height", a::HEIGHT, "RW", (4, height, 4));
    let formats: Vec<(&str, u32)> = PixelCode::ALL.iter().map(|f| (f.name(), f.code())).collect();
    d.choice("PixelFormat", a::PIXEL_FORMAT, "RW", &formats, &[]);
    d.integer("PayloadSize", a::PAYLOAD_SIZE, "RO", (0, i64::from(u32::MAX), 1));
}

fn acquisition(d: &mut Description, sensor: &Sensor) {
    d.choice("AcquisitionMode", a::ACQUISITION_MODE, "RW", &[("Continuous", 0), ("SingleFrame", 1)], &[]);
    d.command("AcquisitionStart", a::ACQUISITION_START, 1);
    d.command("AcquisitionStop", a::ACQUISITION_STOP, 1);
    d.float("AcquisitionFrameRate", a::FRAME_RATE, "RW", (0.01, sensor.max_fps), "Hz");
    d.boolean("AcquisitionFrameRateEnable", a::FRAME_RATE_ENABLE);
    d.choice("ExposureMode", a::EXPOSURE_MODE, "RW", &[("Timed", 0)], &[]);
    d.float("ExposureTime", a::EXPOSURE, "RW", (sensor.shortest_us, sensor.longest_us), "us");
    d.choice("ExposureAuto", a::EXPOSURE_AUTO, "RW", &[("Off", 0), ("Once", 1), ("Continuous", 2)], &[]);
    let gated = ["TriggerMode", "TriggerSource", "TriggerSoftware"];
    d.choice("TriggerSelector", a::TRIGGER_SELECTOR, "RW", &[("FrameStart", 0)], &gated);
    d.choice("TriggerMode", a::TRIGGER_MODE, "RW", &[("Off", 0), ("On", 1)], &[]);
    d.choice("TriggerSource", a::TRIGGER_SOURCE, "RW", &[("Software", 0), ("Line1", 1)], &[]);
    d.command("TriggerSoftware", a::TRIGGER_SOFTWARE, 1);
    d.float("Gain", a::GAIN, "RW", (0.0, 24.0), "dB");
    d.choice("GainAuto", a::GAIN_AUTO, "RW", &[("Off", 0), ("Once", 1), ("Continuous", 2)], &[]);
    d.float("BlackLevel", a::BLACK_LEVEL, "RW", (0.0, 255.0), "DN");
}

fn transport(d: &mut Description) {
    d.integer("TLParamsLocked", a::PARAMETERS_LOCKED, "RW", (0, 1, 1));
    d.integer("GevHeartbeatTimeout", a::HEARTBEAT_MS, "RW", (500, 65_000, 1));
    d.command("GevTimestampControlLatch", a::STAMP_CONTROL, 2);
    let frequency = "GevTimestampTickFrequency";
    let _ = writeln!(
        d.0,
        "<Integer Name=\"{frequency}\" NameSpace=\"Standard\"><pValue>{frequency}Register</pValue></Integer>"
    );
    d.register("IntReg", "GevTimestampTickFrequencyRegister", a::TICK_HIGH, 8, "RO", "Device");
    let _ = writeln!(
        d.0,
        "<Integer Name=\"GevTimestampValue\" NameSpace=\"Standard\"><pValue>GevTimestampValueRegister</pValue></Integer>"
    );
    d.register("IntReg", "GevTimestampValueRegister", a::STAMP_HIGH, 8, "RO", "Device");
    for (name, bit) in [("GevSCPSFireTestPacket", 0), ("GevSCPSDoNotFragment", 1)] {
        let _ = writeln!(
            d.0,
            "<Boolean Name=\"{name}\" NameSpace=\"Standard\"><pValue>{name}Register</pValue><OnValue>1</OnValue><OffValue>0</OffValue></Boolean>"
        );
        let _ = writeln!(
            d.0,
            "<MaskedIntReg Name=\"{name}Register\"><Address>0x{:x}</Address><Length>4</Length><AccessMode>RW</AccessMode><pPort>Device</pPort><Cachable>NoCache</Cachable><Bit>{bit}</Bit><Sign>Unsigned</Sign><Endianess>BigEndian</Endianess></MaskedIntReg>",
            a::PACKET_SIZE
        );
    }
    let packet = "GevSCPSPacketSize";
    let _ = writeln!(
        d.0,
        "<Integer Name=\"{packet}\" NameSpace=\"Standard\"><pValue>{packet}Register</pValue><Min>576</Min><Max>16000</Max><Inc>4</Inc></Integer>"
    );
    let _ = writeln!(
        d.0,
        "<MaskedIntReg Name=\"{packet}Register\"><Address>0x{:x}</Address><Length>4</Length><AccessMode>RW</AccessMode><pPort>Device</pPort><Cachable>NoCache</Cachable><LSB>31</LSB><MSB>16</MSB><Sign>Unsigned</Sign><Endianess>BigEndian</Endianess></MaskedIntReg>",
        a::PACKET_SIZE
    );
    d.integer("GevSCPD", a::PACKET_DELAY, "RW", (0, 100_000_000, 1));
}

fn chunks(d: &mut Description) {
    d.boolean("ChunkModeActive", a::CHUNK_ACTIVE);
    let kinds = [("ExposureTime", 0), ("Timestamp", 1), ("FrameID", 2)];
    d.choice("ChunkSelector", a::CHUNK_SELECTOR, "RW", &kinds, &["ChunkEnable"]);
    d.boolean("ChunkEnable", a::CHUNK_ENABLE);
    d.chunk("ChunkExposureTime", CHUNK_IDS[1], true);
    d.chunk("ChunkTimestamp", CHUNK_IDS[2], false);
    d.chunk("ChunkFrameID", CHUNK_IDS[3], false);
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used)]
    use super::*;
    use std::collections::HashSet;

    #[test]
    fn the_description_is_well_formed_and_every_name_it_points_to_is_there() {
        let text = describe(&Sensor::default());
        let document = roxmltree::Document::parse(&text).unwrap();
        let names: HashSet<&str> = document.descendants().filter_map(|n| n.attribute("Name")).collect();
        for node in document.descendants() {
            if ["pValue", "pFeature", "pPort", "pSelected"].contains(&node.tag_name().name()) {
                let target = node.text().unwrap_or_default();
                assert!(names.contains(target), "{target} is pointed to and missing");
            }
        }
        assert!(names.contains("ExposureTime") && text.len() < 0x1_0000);
    }
}
