//! Takes one good frame: settings applied and proven, camera armed, early frames thrown away, the guard asked; a frame
//! that does not fit is taken again, a bounded number of times.

use super::bracket::Bracket;
use super::guard::{self, Expectation, Rejection, StreamHistory};
use super::picture::Picture;
use goniod_drivers::clock::Clock;
use goniod_drivers::contract::{Armed, Camera, CameraSettings};
use goniod_drivers::error::{DeviceError, ErrorKind};
use goniod_drivers::frame::Frame;
use std::time::Duration;
use thiserror::Error;
use tokio::time::Instant;

/// Limit for writing and reading back settings and for arming, beyond the exposure: a camera may finish a frame first.
const COMMAND_MARGIN: Duration = Duration::from_secs(5);

/// Frames from before the arming that one attempt lets pass; more means that the stream is not what it says.
const EARLY_FRAMES: u32 = 16;

/// What to take.
#[derive(Debug, Clone, Copy)]
pub struct Request<'a> {
    /// The camera's name for errors.
    pub camera: &'a str,
    /// Settings.
    pub settings: CameraSettings,
    /// The shutter is closed.
    pub dark: bool,
    /// Rows at the top that are not picture.
    pub skip_rows: usize,
    /// Attempts at most.
    pub attempts: u32,
    /// The other frames of the bracket.
    pub bracket: &'a Bracket,
}

/// A frame that passed.
#[derive(Debug)]
pub struct Acquired {
    /// The frame.
    pub frame: Frame,
    /// The frame in short.
    pub picture: Picture,
    /// Attempts it took.
    pub attempts: u32,
}

/// Why no frame was had.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum AcquireError {
    /// The camera gave an error.
    #[error(transparent)]
    Device(#[from] DeviceError),
    /// No frame passed the guard.
    #[error("no frame passed in {attempts} attempts; the last: {last}")]
    Rejected {
        /// Attempts made.
        attempts: u32,
        /// The last reason.
        last: Rejection,
    },
}

/// Takes one good frame. Each frame thrown away as unfit is appended to `rejected`; frames that the camera itself
/// announced as not to be used are not, nor is a black one that a second look confirmed.
///
/// # Errors
/// [`AcquireError`].
pub async fn acquire(
    camera: &mut dyn Camera,
    history: &mut StreamHistory,
    request: &Request<'_>,
    clock: Clock,
    rejected: &mut Vec<Rejection>,
) -> Result<Acquired, AcquireError> {
    let (mut last, mut black) = (Rejection::Damaged, None);
    for attempt in 1..=request.attempts.max(1) {
        match attempt_once(camera, history, request, clock, &mut black, rejected).await? {
            Ok((frame, picture)) => {
                if request.dark {
                    history.keep_dark(frame.info.settings.exposure, &picture);
                }
                if picture.is_black() {
                    // The second look agreed: there was nothing wrong with the first.
                    rejected.retain(|reason| *reason != Rejection::BlackUnconfirmed);
                }
                return Ok(Acquired { frame, picture, attempts: attempt });
            }
            Err(reason) => {
                rejected.push(reason.clone());
                last = reason;
            }
        }
    }
    Err(AcquireError::Rejected { attempts: request.attempts.max(1), last })
}

/// One attempt; `black` is the black picture of the attempt before, where a second look is to decide.
async fn attempt_once(
    camera: &mut dyn Camera,
    history: &mut StreamHistory,
    request: &Request<'_>,
    clock: Clock,
    black: &mut Option<Picture>,
    rejected: &mut Vec<Rejection>,
) -> Result<Result<(Frame, Picture), Rejection>, DeviceError> {
    let name = request.camera;
    let command = request.settings.exposure.duration() + COMMAND_MARGIN;
    let applied = limited(clock, command, name, camera.apply(request.settings)).await?;
    if !guard::settings_taken(request.settings, applied) {
        return Ok(Err(Rejection::SettingsNotTaken { exposure_us: applied.exposure.0, gain: applied.gain }));
    }
    let armed = limited(clock, command, name, camera.arm()).await?;
    let armed_at = clock.now();
    // The camera's own promise: exposure, read-out and its margin. A frame that does not come then does not come.
    let limit = armed.due_within;
    let stream = (&armed, armed_at, request.skip_rows);
    let (frame, previous_id) = match take(camera, history, stream, (clock, limit, name), rejected).await? {
        Ok(taken) => taken,
        Err(reason) => return Ok(Err(reason)),
    };
    let before = black.take();
    let expected = Expectation {
        camera: camera.info(),
        settings: applied,
        armed: &armed,
        armed_at,
        now: clock.now(),
        previous_id,
        dark: request.dark,
        black_before: before.as_ref(),
        bracket: request.bracket,
    };
    let mut picture = Picture::of(&frame.info, &frame.pixels, request.skip_rows);
    let verdict = guard::judge(&frame.info, picture.as_mut(), history, &expected);
    remember(history, &frame, picture.as_ref());
    match (verdict, picture) {
        (Ok(()), Some(picture)) => Ok(Ok((frame, picture))),
        (Ok(()), None) => Ok(Err(Rejection::Damaged)),
        (Err(reason), picture) => {
            *black = picture.filter(|_| reason == Rejection::BlackUnconfirmed);
            Ok(Err(reason))
        }
    }
}

/// The first frame that counts, with the counter of the one before it.
async fn take(
    camera: &mut dyn Camera,
    history: &mut StreamHistory,
    (armed, armed_at, skip_rows): (&Armed, Instant, usize),
    (clock, limit, name): (Clock, Duration, &str),
    rejected: &mut Vec<Rejection>,
) -> Result<Result<(Frame, Option<u64>), Rejection>, DeviceError> {
    let (mut to_discard, mut early, mut previous_id) = (armed.discard, 0, None);
    loop {
        let frame = limited(clock, limit, name, camera.next_frame()).await?;
        let (id, start) = (frame.info.device_frame_id, frame.info.exposure_start);
        if start < armed.not_before {
            // Under way when the camera was armed, as happens in a free-running stream; one that lay in the queue is a fault.
            early += 1;
            if frame.info.received < armed_at {
                rejected.push(Rejection::QueueNotDrained);
            }
            if early > EARLY_FRAMES {
                let early_us = (armed.not_before - start).as_micros() as u64;
                return Ok(Err(Rejection::TooEarly { early_us }));
            }
        } else if to_discard > 0 {
            to_discard -= 1;
        } else {
            return Ok(Ok((frame, previous_id)));
        }
        remember(history, &frame, Picture::of(&frame.info, &frame.pixels, skip_rows).as_ref());
        previous_id = Some(id);
    }
}

/// Takes note of a frame that has arrived, good or not: none may come again under a later number.
fn remember(history: &mut StreamHistory, frame: &Frame, picture: Option<&Picture>) {
    history.saw(frame.info.device_frame_id);
    if let Some(picture) = picture {
        history.keep(frame.info.settings.exposure, picture);
    }
}

async fn limited<T>(
    clock: Clock,
    limit: Duration,
    camera: &str,
    work: impl Future<Output = goniod_drivers::error::Result<T>>,
) -> Result<T, DeviceError> {
    clock.timeout(limit, work).await.unwrap_or_else(|_| {
        let message = format!("no answer within {} s; check its cable and power", limit.as_secs());
        Err(DeviceError::new(ErrorKind::Timeout, format!("camera {camera}"), message))
    })
}
