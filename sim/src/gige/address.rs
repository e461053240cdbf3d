//! Register addresses of the twin: the bootstrap block of the GigE Vision standard and the block our GenICam XML names.

/// Device mode and character set.
pub const DEVICE_MODE: u32 = 0x0004;
/// Lower half of the MAC address.
pub const MAC_LOW: u32 = 0x000c;
/// IP configuration supported.
pub const IP_OPTIONS: u32 = 0x0010;
/// IP configuration in force.
pub const IP_CONFIG: u32 = 0x0014;
/// IP address now.
pub const IP: u32 = 0x0024;
/// Subnet mask now.
pub const MASK: u32 = 0x0034;
/// Manufacturer's name, 32 bytes.
pub const VENDOR: u32 = 0x0048;
/// Model name, 32 bytes.
pub const MODEL: u32 = 0x0068;
/// Firmware version, 32 bytes.
pub const VERSION: u32 = 0x0088;
/// Free text of the maker, 48 bytes.
pub const INFO: u32 = 0x00a8;
/// Serial number, 16 bytes.
pub const SERIAL: u32 = 0x00d8;
/// Name the user gave, 16 bytes.
pub const USER_NAME: u32 = 0x00e8;
/// First byte after the block that a discovery answer carries.
pub const DISCOVERY_END: u32 = 0x00f8;
/// Where the XML lies, 512 bytes.
pub const XML_URL: u32 = 0x0200;
/// Number of network interfaces.
pub const INTERFACES: u32 = 0x0600;
/// Number of stream channels.
pub const STREAM_CHANNELS: u32 = 0x0904;
/// Capability bits.
pub const CAPABILITY: u32 = 0x0934;
/// Heartbeat time-out in milliseconds.
pub const HEARTBEAT_MS: u32 = 0x0938;
/// Time-stamp frequency, upper word; the lower follows.
pub const TICK_HIGH: u32 = 0x093c;
/// Time-stamp control: 2 latches, 1 resets.
pub const STAMP_CONTROL: u32 = 0x0944;
/// Latched time stamp, upper word; the lower follows.
pub const STAMP_HIGH: u32 = 0x0948;
/// Control channel privilege.
pub const PRIVILEGE: u32 = 0x0a00;
/// Host port of stream channel 0.
pub const STREAM_PORT: u32 = 0x0d00;
/// Packet size, with the bits that fire a test packet and forbid fragments.
pub const PACKET_SIZE: u32 = 0x0d04;
/// Delay between packets in ticks.
pub const PACKET_DELAY: u32 = 0x0d08;
/// Address that the stream goes to.
pub const STREAM_ADDRESS: u32 = 0x0d18;
/// Port that the stream comes from.
pub const STREAM_SOURCE: u32 = 0x0d1c;

/// Columns of the picture.
pub const WIDTH: u32 = 0x1_0000;
/// Rows of the picture.
pub const HEIGHT: u32 = 0x1_0004;
/// Pixel format code.
pub const PIXEL_FORMAT: u32 = 0x1_0008;
/// Bytes of one block.
pub const PAYLOAD_SIZE: u32 = 0x1_000c;
/// Columns of the sensor.
pub const SENSOR_WIDTH: u32 = 0x1_0010;
/// Rows of the sensor.
pub const SENSOR_HEIGHT: u32 = 0x1_0014;
/// 0 continuous, 1 single frame.
pub const ACQUISITION_MODE: u32 = 0x1_0018;
/// Writing starts acquisition.
pub const ACQUISITION_START: u32 = 0x1_001c;
/// Writing stops acquisition.
pub const ACQUISITION_STOP: u32 = 0x1_0020;
/// Frames a second, double.
pub const FRAME_RATE: u32 = 0x1_0028;
/// 1 = the frame rate above bounds the free run.
pub const FRAME_RATE_ENABLE: u32 = 0x1_0030;
/// Integration time in microseconds, double.
pub const EXPOSURE: u32 = 0x1_0038;
/// 0 off, 2 continuous.
pub const EXPOSURE_AUTO: u32 = 0x1_0040;
/// 0 timed.
pub const EXPOSURE_MODE: u32 = 0x1_0044;
/// Gain in dB, double.
pub const GAIN: u32 = 0x1_0048;
/// 0 off, 2 continuous.
pub const GAIN_AUTO: u32 = 0x1_0050;
/// Black level, double.
pub const BLACK_LEVEL: u32 = 0x1_0058;
/// 0 frame start.
pub const TRIGGER_SELECTOR: u32 = 0x1_0060;
/// 1 = frames wait for triggers.
pub const TRIGGER_MODE: u32 = 0x1_0064;
/// 0 software, 1 line 1.
pub const TRIGGER_SOURCE: u32 = 0x1_0068;
/// Writing triggers one frame.
pub const TRIGGER_SOFTWARE: u32 = 0x1_006c;
/// 0 sensor, 1 main board.
pub const TEMPERATURE_SELECTOR: u32 = 0x1_0070;
/// Temperature in degrees Celsius, double.
pub const TEMPERATURE: u32 = 0x1_0078;
/// Cooler: 0 off, 1 settling, 2 locked.
pub const COOLER: u32 = 0x1_0080;
/// 1 = blocks carry chunks.
pub const CHUNK_ACTIVE: u32 = 0x1_0084;
/// Which chunk `CHUNK_ENABLE` speaks of.
pub const CHUNK_SELECTOR: u32 = 0x1_0088;
/// 1 = the selected chunk is sent.
pub const CHUNK_ENABLE: u32 = 0x1_008c;
/// Writing restarts the camera.
pub const DEVICE_RESET: u32 = 0x1_0090;
/// 1 while the host streams.
pub const PARAMETERS_LOCKED: u32 = 0x1_0094;
/// End of the register file.
pub const END: u32 = 0x1_00a0;
/// Where the XML begins.
pub const XML: u32 = 0x2_0000;
