//! The guard: proves that a frame fits its label before anybody may use it. Pure.
//!
//! A frame is data only if the queue was drained before the trigger, the device's frame id advanced by exactly one, its
//! time lies in the exposure window, the settings read back equal the command, size, format and flags are right, it is not
//! equal to a recent frame, not constant, not black unless that is expected, and its counts fit what the bracket predicts.

use super::bracket::{Black, Bracket, Contradiction};
use super::picture::Picture;
use goniod_drivers::contract::{Armed, CameraInfo, CameraSettings};
use goniod_drivers::frame::FrameInfo;
use goniod_drivers::units::ExposureTime;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, VecDeque};
use std::time::Duration;
use thiserror::Error;
use tokio::time::Instant;

/// Fingerprints kept to recognise a frame that comes again.
const RECENT: usize = 32;

/// How much a frame may seem to arrive before its exposure ended: the host's and the device's clocks differ.
const CLOCK_SLACK: Duration = Duration::from_millis(20);

/// Largest relative difference between a setting asked for and applied, for devices that count in coarse units.
pub const SETTING_TOLERANCE: f64 = 0.01;

/// Why a frame was thrown away.
#[derive(Debug, Clone, PartialEq, Error, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Rejection {
    /// The device flagged the buffer, or it is shorter than it should be.
    #[error("the buffer is damaged or short")]
    Damaged,
    /// It was good, but its file in the store was found damaged or gone.
    #[error("its file was damaged or gone when the run was gone on with")]
    FileDamaged,
    /// Another camera's frame.
    #[error("it comes from camera {0}")]
    WrongCamera(String),
    /// Other size or pixel format.
    #[error("it has another size or pixel format: {0}")]
    WrongShape(String),
    /// Taken with other settings than those applied.
    #[error("it was taken with {exposure_us} µs, gain {gain}")]
    WrongSettings {
        /// Exposure it was taken with, microseconds.
        exposure_us: u64,
        /// Gain it was taken with.
        gain: f64,
    },
    /// The camera applied other settings than asked for.
    #[error("the camera applied {exposure_us} µs, gain {gain} instead of what was asked for")]
    SettingsNotTaken {
        /// Exposure read back, microseconds.
        exposure_us: u64,
        /// Gain read back.
        gain: f64,
    },
    /// The frame counter stood or went back.
    #[error("frame counter {got} after {previous}")]
    NotAdvanced {
        /// Counter of the frame before.
        previous: u64,
        /// Counter of this frame.
        got: u64,
    },
    /// The frame counter jumped: frames were lost.
    #[error("frame counter {got} after {previous}: frames were lost")]
    FramesLost {
        /// Counter of the frame before.
        previous: u64,
        /// Counter of this frame.
        got: u64,
    },
    /// It lay in the queue when the camera was armed.
    #[error("it lay in the queue before the camera was armed")]
    QueueNotDrained,
    /// Its exposure began before bench and settings were ready.
    #[error("its exposure began {early_us} µs too early")]
    TooEarly {
        /// By how much, microseconds.
        early_us: u64,
    },
    /// Start of exposure, exposure and arrival do not fit together.
    #[error("exposure and arrival do not fit together")]
    OutsideWindow,
    /// Every pixel equals those of a recent frame.
    #[error("it repeats a recent frame")]
    Repeated,
    /// All pixels have one level.
    #[error("all pixels have the level {0}")]
    Constant(u16),
    /// Black where other frames of the bracket say there is light.
    #[error("it is black where the bracket has light")]
    Black,
    /// Black with nothing known about it: a second look decides.
    #[error("it is black; a second look decides")]
    BlackUnconfirmed,
    /// The levels do not fit the other exposures of the bracket.
    #[error("its levels stand {:.2} times to those at {} µs; {:.2} to {:.2} would fit", .0.rise, .0.other_us, .0.least, .0.greatest)]
    Bracket(Contradiction),
}

/// What is remembered of a camera's stream from frame to frame.
#[derive(Debug, Default)]
pub struct StreamHistory {
    last_id: Option<u64>,
    /// Fingerprints and exposures of the frames that arrived last.
    recent: VecDeque<(u64, ExposureTime)>,
    darks: BTreeMap<ExposureTime, DarkSeen>,
}

/// What the darks of an exposure showed.
#[derive(Debug, Default)]
struct DarkSeen {
    /// Most pixels above the level of light: what is hot.
    hot: usize,
    /// They carry noise, so that a picture of one level is none.
    grainy: bool,
}

/// What a frame must be.
#[derive(Debug, Clone, Copy)]
pub struct Expectation<'a> {
    /// The camera as it described itself.
    pub camera: &'a CameraInfo,
    /// The settings as read back.
    pub settings: CameraSettings,
    /// What `arm` promised.
    pub armed: &'a Armed,
    /// When the camera had been armed.
    pub armed_at: Instant,
    /// Now.
    pub now: Instant,
    /// Counter of the frame taken right before this one since the camera was armed; `None` for the first.
    pub previous_id: Option<u64>,
    /// The shutter is closed.
    pub dark: bool,
    /// The black picture that the attempt before gave.
    pub black_before: Option<&'a Picture>,
    /// The other frames of the bracket.
    pub bracket: &'a Bracket,
}

// === impl StreamHistory ===

impl StreamHistory {
    /// Takes note of a frame that arrived, good or not.
    pub fn saw(&mut self, device_frame_id: u64) {
        self.last_id = Some(device_frame_id);
    }

    /// Counter of the last frame that arrived.
    pub fn last_id(&self) -> Option<u64> {
        self.last_id
    }

    /// Takes note of the picture of a frame that arrived, good or not.
    pub fn keep(&mut self, exposure: ExposureTime, picture: &Picture) {
        if self.recent.len() == RECENT {
            self.recent.pop_front();
        }
        self.recent.push_back((picture.fingerprint, exposure));
    }

    /// Takes note of an accepted dark.
    pub fn keep_dark(&mut self, exposure: ExposureTime, picture: &Picture) {
        let seen = self.darks.entry(exposure).or_default();
        seen.hot = picture.lit.max(seen.hot);
        seen.grainy |= picture.is_grainy();
    }

    /// True when more pixels have light than in every dark of this exposure; false when there was no dark yet.
    fn shows_light(&self, exposure: ExposureTime, picture: &Picture) -> bool {
        self.darks.get(&exposure).is_some_and(|seen| picture.lit > seen.hot)
    }

    /// True when the picture has one level although even the darks of this exposure have noise.
    fn lost_its_noise(&self, exposure: ExposureTime, picture: &Picture) -> bool {
        picture.is_constant() && self.darks.get(&exposure).is_some_and(|seen| seen.grainy)
    }

    /// True when the picture comes again and cannot have come twice by itself: frames with noise never do, a peak of few
    /// pixels is another one at another exposure. What is clipped at both ends may look the same each time.
    fn repeats(&self, exposure: ExposureTime, picture: &Picture) -> bool {
        let singular = picture.is_grainy() || !(picture.is_black() || picture.is_constant());
        let peak = picture.shows_light && picture.between > 0;
        let equal = |(fingerprint, other): &(u64, ExposureTime)| {
            *fingerprint == picture.fingerprint && (singular || (peak && *other != exposure))
        };
        self.recent.iter().any(equal)
    }

    /// The camera was opened again: its counter may begin anew.
    pub fn reopened(&mut self) {
        self.last_id = None;
    }
}

/// Judges a frame by what it says of itself and its picture in short (`None`: the pixels are too few or too many), and
/// notes in the picture whether it shows light.
///
/// # Errors
/// The first reason against it.
pub fn judge(
    info: &FrameInfo,
    picture: Option<&mut Picture>,
    history: &StreamHistory,
    expected: &Expectation<'_>,
) -> Result<(), Rejection> {
    judge_label(info, expected)?;
    judge_counter(info, history, expected)?;
    judge_time(info, expected)?;
    let picture = picture.ok_or(Rejection::Damaged)?;
    picture.shows_light = history.shows_light(info.settings.exposure, picture);
    judge_light(picture, history, expected)?;
    expected.bracket.judge(expected.settings.exposure, picture).map_err(Rejection::Bracket)
}

/// True when a setting applied is near enough to the one asked for.
pub fn settings_taken(asked: CameraSettings, applied: CameraSettings) -> bool {
    let near = |a: f64, b: f64| (a - b).abs() <= SETTING_TOLERANCE * a.abs().max(b.abs());
    near(asked.exposure.seconds(), applied.exposure.seconds()) && near(asked.gain, applied.gain)
}

fn judge_label(info: &FrameInfo, expected: &Expectation<'_>) -> Result<(), Rejection> {
    let camera = expected.camera;
    if info.damaged {
        return Err(Rejection::Damaged);
    }
    if info.camera_serial != camera.identity.serial {
        return Err(Rejection::WrongCamera(info.camera_serial.clone()));
    }
    if (info.width, info.height, info.format) != (camera.width, camera.height, camera.format) {
        return Err(Rejection::WrongShape(format!("{} x {} {:?}", info.width, info.height, info.format)));
    }
    if info.settings != expected.settings {
        let CameraSettings { exposure, gain } = info.settings;
        return Err(Rejection::WrongSettings { exposure_us: exposure.0, gain });
    }
    Ok(())
}

fn judge_counter(info: &FrameInfo, history: &StreamHistory, expected: &Expectation<'_>) -> Result<(), Rejection> {
    let got = info.device_frame_id;
    if let Some(previous) = history.last_id.filter(|previous| got <= *previous) {
        return Err(Rejection::NotAdvanced { previous, got });
    }
    match expected.previous_id {
        Some(previous) if got != previous + 1 => Err(Rejection::FramesLost { previous, got }),
        _ => Ok(()),
    }
}

fn judge_time(info: &FrameInfo, expected: &Expectation<'_>) -> Result<(), Rejection> {
    if info.received < expected.armed_at {
        return Err(Rejection::QueueNotDrained);
    }
    if info.exposure_start < expected.armed.not_before {
        let early = expected.armed.not_before - info.exposure_start;
        return Err(Rejection::TooEarly { early_us: early.as_micros() as u64 });
    }
    let end = info.exposure_start + info.settings.exposure.duration();
    if end > info.received + CLOCK_SLACK || info.received > expected.now {
        return Err(Rejection::OutsideWindow);
    }
    Ok(())
}

fn judge_light(picture: &Picture, history: &StreamHistory, expected: &Expectation<'_>) -> Result<(), Rejection> {
    let exposure = expected.settings.exposure;
    if history.lost_its_noise(exposure, picture) {
        return Err(Rejection::Constant(picture.lowest));
    }
    if picture.is_black() && !expected.dark {
        match expected.bracket.black_at(exposure) {
            Black::Impossible => return Err(Rejection::Black),
            Black::Open if !picture.shows_light && !expected.black_before.is_some_and(|b| b.confirms(picture)) => {
                return Err(Rejection::BlackUnconfirmed);
            }
            // An 8-bit sensor clips to zero below its response's offset: such frames are constant and all alike.
            Black::Open | Black::Expected => {}
        }
    }
    let clipped = picture.is_black() || (picture.is_saturated() && expected.bracket.saturated_before(exposure));
    if picture.is_constant() && !clipped {
        return Err(Rejection::Constant(picture.lowest));
    }
    if history.repeats(exposure, picture) {
        return Err(Rejection::Repeated);
    }
    Ok(())
}

#[cfg(test)]
pub mod test_support {
    //! Pictures for the tests of guard and bracket.
    #![allow(clippy::unwrap_used, clippy::expect_used)]
    use super::*;
    use goniod_drivers::clock::UtcMicros;
    use goniod_drivers::frame::{PixelFormat, Pixels};
    use goniod_drivers::units::ExposureTime;

    /// Settings of an exposure at gain 1.
    pub fn settings(exposure_us: u64) -> CameraSettings {
        CameraSettings { exposure: ExposureTime(exposure_us), gain: 1.0 }
    }

    /// Information of an 8-bit frame, `width` x 1.
    pub fn info(width: usize, id: u64, start: Instant, exposure_us: u64) -> FrameInfo {
        FrameInfo {
            camera_serial: "S1".to_owned(),
            device_frame_id: id,
            exposure_start: start,
            received: start + Duration::from_micros(exposure_us),
            utc: UtcMicros(0),
            settings: settings(exposure_us),
            width,
            height: 1,
            format: PixelFormat::Mono8,
            damaged: false,
        }
    }

    /// The picture of 8-bit levels.
    pub fn picture_of(levels: &[u16]) -> Picture {
        let pixels = Pixels::U8(levels.iter().map(|l| *l as u8).collect());
        Picture::of(&info(levels.len(), 0, Instant::now(), 1000), &pixels, 0).unwrap()
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used)]
    use super::test_support::{info, settings};
    use super::*;
    use goniod_drivers::contract::Identity;
    use goniod_drivers::frame::{PixelFormat, Pixels};
    use goniod_drivers::units::ExposureTime;

    const WIDTH: usize = 200;

    fn camera() -> CameraInfo {
        CameraInfo {
            identity: Identity { model: "M".into(), firmware: "1".into(), serial: "S1".into() },
            width: WIDTH,
            height: 1,
            format: PixelFormat::Mono8,
            shortest: ExposureTime(1),
            longest: ExposureTime(60_000_000),
        }
    }

    fn light(seed: u64) -> Pixels {
        Pixels::U8((0..WIDTH as u64).map(|i| 40 + ((i * 7 + seed) % 60) as u8).collect())
    }

    struct Case {
        info: FrameInfo,
        pixels: Pixels,
        history: StreamHistory,
        bracket: Bracket,
        dark: bool,
        black_before: Option<Pixels>,
        previous_id: Option<u64>,
    }

    /// A good frame: armed at the start, exposed 10 ms later for 10 ms.
    fn good() -> (Case, Instant) {
        let t0 = Instant::now();
        let case = Case {
            info: info(WIDTH, 8, t0 + Duration::from_millis(10), 10_000),
            pixels: light(0),
            history: StreamHistory::default(),
            bracket: Bracket::default(),
            dark: false,
            black_before: None,
            previous_id: None,
        };
        (case, t0)
    }

    fn verdict(case: &Case, t0: Instant) -> Result<(), Rejection> {
        let armed = Armed { not_before: t0, discard: 0, due_within: Duration::from_secs(1) };
        let picture = |pixels: &Pixels| Picture::of(&case.info, pixels, 0);
        let black_before = case.black_before.as_ref().and_then(picture);
        let expected = Expectation {
            camera: &camera(),
            settings: settings(10_000),
            armed: &armed,
            armed_at: t0,
            now: t0 + Duration::from_secs(5),
            previous_id: case.previous_id,
            dark: case.dark,
            black_before: black_before.as_ref(),
            bracket: &case.bracket,
        };
        judge(&case.info, picture(&case.pixels).as_mut(), &case.history, &expected)
    }

    fn rejected(change: impl FnOnce(&mut Case, Instant)) -> Rejection {
        let (mut case, t0) = good();
        change(&mut case, t0);
        verdict(&case, t0).expect_err("the guard must refuse it")
    }

    #[tokio::test(start_paused = true)]
    async fn a_good_frame_passes() {
        tokio::time::advance(Duration::from_secs(60)).await;
        let (case, t0) = good();
        assert_eq!(verdict(&case, t0), Ok(()));
    }

    #[tokio::test(start_paused = true)]
    async fn each_wrong_label_is_refused_with_its_reason() {
        tokio::time::advance(Duration::from_secs(60)).await;
        let ms = Duration::from_millis;
        assert_eq!(rejected(|c, _| c.info.damaged = true), Rejection::Damaged);
        assert_eq!(rejected(|c, _| c.pixels = Pixels::U8(vec![50; WIDTH - 1])), Rejection::Damaged);
        assert_eq!(rejected(|c, _| c.info.camera_serial = "S2".into()), Rejection::WrongCamera("S2".into()));
        assert!(matches!(rejected(|c, _| c.info.height = 2), Rejection::WrongShape(_)));
        assert!(matches!(rejected(|c, _| c.info.format = PixelFormat::BayerRggb8), Rejection::WrongShape(_)));
        let wrong = Rejection::WrongSettings { exposure_us: 9_999, gain: 1.0 };
        assert_eq!(rejected(|c, _| c.info.settings.exposure = ExposureTime(9_999)), wrong);
        assert_eq!(rejected(|c, _| c.history.saw(8)), Rejection::NotAdvanced { previous: 8, got: 8 });
        let lost = Rejection::FramesLost { previous: 6, got: 8 };
        assert_eq!(rejected(|c, _| c.previous_id = Some(6)), lost);
        assert_eq!(rejected(|c, t0| c.info.received = t0 - ms(1)), Rejection::QueueNotDrained);
        let early = Rejection::TooEarly { early_us: 1000 };
        assert_eq!(rejected(|c, t0| c.info.exposure_start = t0 - ms(1)), early);
        assert_eq!(rejected(|c, t0| c.info.exposure_start = t0 + ms(100)), Rejection::OutsideWindow);
        assert_eq!(rejected(|c, t0| c.info.received = t0 + ms(6000)), Rejection::OutsideWindow);
    }

    #[tokio::test(start_paused = true)]
    async fn constant_repeated_black_and_contradicting_pictures_are_refused() {
        let black = || Pixels::U8((0..WIDTH).map(|i| (i % 2) as u8).collect());
        let keep = |c: &mut Case, seed, us: u64| {
            let picture = Picture::of(&c.info, &light(seed), 0).unwrap();
            c.history.keep(ExposureTime(us), &picture);
            c.bracket.add(ExposureTime(us), picture);
        };
        assert_eq!(rejected(|c, _| c.pixels = Pixels::U8(vec![90; WIDTH])), Rejection::Constant(90));
        assert_eq!(rejected(|c, _| keep(c, 0, 10_000)), Rejection::Repeated);
        assert_eq!(rejected(|c, _| c.pixels = black()), Rejection::BlackUnconfirmed);
        let seen = |c: &mut Case, _| {
            keep(c, 1, 2_500);
            c.pixels = black();
            c.black_before = Some(black());
        };
        assert_eq!(rejected(seen), Rejection::Black);
        assert!(matches!(rejected(|c, _| keep(c, 1, 2_500)), Rejection::Bracket(_)));
    }

    /// Clear glass: what passes is a peak of a few pixels, which no dark has.
    #[tokio::test(start_paused = true)]
    async fn a_peak_of_few_pixels_needs_no_second_look_once_a_dark_is_known() {
        let peak = || Pixels::U8((0..WIDTH).map(|i| if i == 77 { 250 } else { (i % 2) as u8 }).collect());
        let dark = Picture::of(&info(WIDTH, 1, Instant::now(), 10_000), &Pixels::U8(vec![0; WIDTH]), 0).unwrap();
        assert_eq!(rejected(|c, _| c.pixels = peak()), Rejection::BlackUnconfirmed);
        let (mut case, t0) = good();
        case.pixels = peak();
        case.history.keep_dark(ExposureTime(10_000), &dark);
        assert_eq!(verdict(&case, t0), Ok(()));
        let hot = Picture::of(&info(WIDTH, 1, Instant::now(), 10_000), &peak(), 0).unwrap();
        case.history.keep_dark(ExposureTime(10_000), &hot);
        assert_eq!(verdict(&case, t0), Err(Rejection::BlackUnconfirmed), "a hot pixel is no light");
    }

    /// What is clipped to zero looks the same each time; what has noise does not, not even without light.
    #[tokio::test(start_paused = true)]
    async fn a_frame_with_noise_never_comes_twice_nor_without_it() {
        let noise = || Pixels::U8((0..WIDTH).map(|i| 1 + (i % 3) as u8).collect());
        let picture = |pixels: &Pixels| Picture::of(&info(WIDTH, 1, Instant::now(), 10_000), pixels, 0).unwrap();
        let dark = |pixels: Pixels, seen: &Pixels| {
            let (mut case, t0) = good();
            case.dark = true;
            case.history.keep(ExposureTime(10_000), &picture(seen));
            case.history.keep_dark(ExposureTime(10_000), &picture(seen));
            case.pixels = pixels;
            verdict(&case, t0)
        };
        let zero = || Pixels::U8(vec![0; WIDTH]);
        let other = || Pixels::U8((0..WIDTH).map(|i| 1 + (i % 2) as u8).collect());
        assert_eq!(dark(zero(), &zero()), Ok(()));
        assert_eq!(dark(other(), &noise()), Ok(()));
        assert_eq!(dark(noise(), &noise()), Err(Rejection::Repeated));
        assert_eq!(dark(zero(), &noise()), Err(Rejection::Constant(0)));
    }

    /// A peak of few pixels is another one at another exposure, and may be the same at the same.
    #[tokio::test(start_paused = true)]
    async fn a_peak_that_comes_again_at_another_exposure_is_refused() {
        let peak = || Pixels::U8((0..WIDTH).map(|i| if i == 77 { 200 } else { 0 }).collect());
        let case = |us: u64| {
            let (mut case, t0) = good();
            case.pixels = peak();
            let zero = Picture::of(&case.info, &Pixels::U8(vec![0; WIDTH]), 0).unwrap();
            case.history.keep_dark(ExposureTime(10_000), &zero);
            case.history.keep(ExposureTime(us), &Picture::of(&case.info, &peak(), 0).unwrap());
            verdict(&case, t0)
        };
        assert_eq!(case(10_000), Ok(()));
        assert_eq!(case(40_000), Err(Rejection::Repeated));
    }

    #[tokio::test(start_paused = true)]
    async fn darks_and_confirmed_black_frames_pass_even_when_clipped_to_zero() {
        let (mut case, t0) = good();
        case.pixels = Pixels::U8(vec![0; WIDTH]);
        case.dark = true;
        assert_eq!(verdict(&case, t0), Ok(()));
        case.dark = false;
        case.black_before = Some(Pixels::U8(vec![0; WIDTH]));
        assert_eq!(verdict(&case, t0), Ok(()));
        // A picture of zeros after a dim one may be a picture lost.
        let dim = || Pixels::U8((0..WIDTH).map(|i| (i % 2) as u8).collect());
        case.black_before = Some(dim());
        assert_eq!(verdict(&case, t0), Err(Rejection::BlackUnconfirmed));
        case.pixels = dim();
        assert_eq!(verdict(&case, t0), Ok(()));
        case.black_before = Some(Pixels::U8(vec![0; WIDTH]));
        assert_eq!(verdict(&case, t0), Ok(()));
    }
}
