//! Video nodes of this machine: found by what sysfs says, linked under their serial number as udev would; and the
//! rules by which a frame is data.

use goniod_drivers::clock::Clock;
use goniod_drivers::contract::{Armed, Camera, CameraSettings};
use goniod_drivers::devices::v4l2::V4l2Camera;
use goniod_drivers::error::{DeviceError, ErrorKind};
use goniod_drivers::frame::Frame;
use goniod_drivers::units::ExposureTime;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Longest wait for a node to come or go.
const PATIENCE: Duration = Duration::from_secs(60);

/// Nodes whose card name contains `card`, capture nodes only.
pub fn nodes(card: &str) -> Vec<(PathBuf, String)> {
    let read = |path: PathBuf| fs::read_to_string(path).unwrap_or_default().trim().to_owned();
    let entries = fs::read_dir("/sys/class/video4linux").into_iter().flatten().flatten();
    entries
        .filter(|e| read(e.path().join("name")).contains(card) && read(e.path().join("index")) == "0")
        .map(|e| (Path::new("/dev").join(e.file_name()), read(e.path().join("device/../serial"))))
        .filter(|(node, _)| node.exists())
        .collect()
}

/// Waits for a camera and gives its link under `/dev/v4l/by-id`, which names its serial number.
pub async fn link(card: &str) -> Result<PathBuf, String> {
    let clock = Clock::system();
    let dir = Path::new("/dev/v4l/by-id");
    fs::create_dir_all(dir).map_err(|e| e.to_string())?;
    while clock.elapsed() < PATIENCE {
        if let Some((node, serial)) = nodes(card).into_iter().next() {
            let link = dir.join(format!("usb-{}_{serial}-video-index0", card.replace(' ', "_")));
            let _ = fs::remove_file(&link);
            std::os::unix::fs::symlink(node, &link).map_err(|e| e.to_string())?;
            return Ok(link);
        }
        clock.sleep(Duration::from_millis(50)).await;
    }
    Err(format!("no video node of \"{card}\" came"))
}

/// Waits until no node of this card is left.
pub async fn gone(card: &str) -> Result<(), String> {
    let clock = Clock::system();
    while clock.elapsed() < PATIENCE {
        if nodes(card).is_empty() {
            return Ok(());
        }
        clock.sleep(Duration::from_millis(50)).await;
    }
    Err(format!("the video node of \"{card}\" did not go"))
}

/// Settings with an exposure in 100 us.
pub fn settings(raw_exposure: u64, gain: f64) -> CameraSettings {
    CameraSettings { exposure: ExposureTime(raw_exposure * 100), gain }
}

/// Frames of one exposure that are data, and those that are not.
pub struct Acquired {
    /// What was armed.
    pub armed: Armed,
    /// Frames kept.
    pub kept: Vec<Frame>,
    /// Frames refused.
    pub refused: u64,
}

/// Applies, arms and takes frames until `count` are data: whole, next in number, begun after the arming, under the
/// settings asked for.
pub async fn acquire(camera: &mut V4l2Camera, want: CameraSettings, count: usize) -> Result<Acquired, DeviceError> {
    let applied = camera.apply(want).await?;
    let mut acquired = Acquired { armed: camera.arm().await?, kept: Vec::new(), refused: 0 };
    let mut last: Option<u64> = None;
    while acquired.kept.len() < count {
        let frame = camera.next_frame().await?;
        let info = &frame.info;
        let next = last.is_none_or(|l| info.device_frame_id == l + 1);
        last = Some(last.unwrap_or(0).max(info.device_frame_id));
        if info.damaged || !next || info.exposure_start < acquired.armed.not_before || info.settings != applied {
            acquired.refused += 1;
        } else {
            acquired.kept.push(frame);
        }
        if acquired.refused > 500 {
            return Err(DeviceError::new(ErrorKind::Broken, "probe", "500 frames in a row were no data"));
        }
    }
    Ok(acquired)
}
