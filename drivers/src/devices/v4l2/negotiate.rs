//! Is it the camera of the configuration, and which picture format do both sides agree on?

use super::config::V4l2Config;
use super::fault::Fault;
use super::formats::{self, Layout};
use crate::contract::Identity;
use crate::error::{ErrorKind, Result};
use v4l::capability::Flags;
use v4l::format::{FieldOrder, FourCC, TransferFunction};
use v4l::video::Capture;
use v4l::{Device, Format};

/// Who it is, proven against the configuration.
pub fn identify(device: &Device, config: &V4l2Config) -> Result<Identity> {
    let fault = Fault(&config.name);
    let caps = device.query_caps().map_err(|e| fault.io("asking for the capabilities", &e))?;
    if !caps.capabilities.contains(Flags::VIDEO_CAPTURE | Flags::STREAMING) {
        return Err(fault.of(
            ErrorKind::WrongDevice,
            format!(
                "{} ({}) does not stream pictures; name the capture node of the camera",
                config.node.display(),
                caps.card
            ),
        ));
    }
    let node = config.node.to_string_lossy();
    if !caps.card.contains(&config.card) || !node.contains(&config.serial) {
        return Err(fault.of(
            ErrorKind::WrongDevice,
            format!(
                "{node} is \"{}\", expected \"{}\" with serial number \"{}\" in the node's by-id name; correct the port",
                caps.card, config.card, config.serial
            ),
        ));
    }
    let (major, minor, patch) = caps.version;
    let firmware = format!("{} {major}.{minor}.{patch}", caps.driver);
    Ok(Identity { model: caps.card, firmware, serial: config.serial.clone() })
}

/// Chooses the format and size and reads back what the device made of them.
pub fn negotiate(device: &Device, config: &V4l2Config) -> Result<(Layout, Option<String>)> {
    let fault = Fault(&config.name);
    let offered: Vec<[u8; 4]> = device
        .enum_formats()
        .map_err(|e| fault.io("asking for the formats", &e))?
        .iter()
        .map(|f| f.fourcc.repr)
        .collect();
    let Some((fourcc, format)) = formats::choose(&offered, config.format) else {
        let names: Vec<_> = offered.iter().map(|f| String::from_utf8_lossy(f).into_owned()).collect();
        return Err(fault.of(
            ErrorKind::Refused,
            format!("the camera offers {}, none of which gives {:?}; change `format`", names.join(", "), config.format),
        ));
    };
    let asked = Format::new(config.width, config.height, FourCC::new(&fourcc));
    let now = device.set_format(&asked).map_err(|e| fault.io("setting the picture format", &e))?;
    if (now.width, now.height, now.fourcc.repr) != (config.width, config.height, fourcc) {
        return Err(fault.of(
            ErrorKind::Refused,
            format!(
                "asked for {} x {} {}, the camera makes {} x {} {} of it; correct width_px, height_px or format",
                config.width, config.height, asked.fourcc, now.width, now.height, now.fourcc
            ),
        ));
    }
    if !matches!(now.field_order, FieldOrder::Progressive | FieldOrder::Any) {
        return Err(fault.of(
            ErrorKind::Refused,
            "the picture is interlaced: two halves of different times; set the source to progressive",
        ));
    }
    tracing::info!(camera = %config.name, format = %now, "picture format");
    let linear = matches!(now.transfer, TransferFunction::Default | TransferFunction::None);
    let curve = (!linear)
        .then(|| format!("the picture has transfer function {}, not linear: undo it before radiometry", now.transfer));
    let (width, height, bytesperline) = (now.width as usize, now.height as usize, now.stride as usize);
    Ok((Layout { fourcc, format, width, height, bytesperline }, curve))
}
