//! A bench in memory for the sequencer's tests: it writes its true state into the top rows of every frame.
#![allow(clippy::unwrap_used, clippy::expect_used)]

use crate::control::devices::bench::{AxisCare, Bench, Devices, Settle};
use async_trait::async_trait;
use goniod_drivers::clock::Clock;
use goniod_drivers::contract::{
    Armed, Camera, CameraInfo, CameraSettings, Device, FilterWheel, Health, Identity, LightMonitor, LightReading,
    RotaryAxis, Shutter, ShutterState,
};
use goniod_drivers::error::{DeviceError, ErrorKind, Result};
use goniod_drivers::frame::{Frame, FrameInfo, PixelFormat, Pixels};
use goniod_drivers::units::{Degrees, DegreesPerSecond, ExposureTime, Nanometres, Slot};
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::{Arc, Mutex};
use std::time::Duration;

pub const WIDTH: usize = 40;
pub const HEIGHT: usize = 32;
pub const RESERVED: usize = 2;
pub const DARK_SLOT: Slot = Slot(12);

/// What a frame can have wrong.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Wrong {
    /// The frame before again, as it lay in the queue.
    Stale,
    /// Pixels of the exposure before under a good label.
    OldPixels,
    /// Counter jumps.
    Skipped,
    /// No light although there is some, under a good label.
    Black,
    /// Taken and labelled with another exposure.
    OtherExposure,
    /// Flagged as damaged.
    Damaged,
}

/// The truth of the bench, and what is going to go wrong.
#[derive(Default)]
pub struct World {
    pub open: bool,
    pub slot: Option<Slot>,
    pub tilt: f64,
    pub spin: f64,
    /// Moves while the shutter was open.
    pub moved_in_light: u32,
    /// Frames delivered, by camera.
    pub frames: BTreeMap<String, u32>,
    /// Faults by camera and number of the frame delivered.
    pub wrong: BTreeMap<(String, u32), Wrong>,
    /// Errors to come, by device: kind, and how many more calls (opening included) give it.
    pub errors: BTreeMap<String, VecDeque<(ErrorKind, u32)>>,
    pub safe: Vec<String>,
    pub homed: u32,
    /// Axes without a reference, as after a power cut.
    pub lost_place: BTreeSet<String>,
    /// Devices that never answer again.
    pub hung: BTreeSet<String>,
    /// A device whose next call ends in a panic.
    pub panics: Option<String>,
    /// Temperature of the cameras.
    pub temperature_c: f64,
    /// The shutter's interlock contact is open.
    pub contact_open: bool,
    /// Devices that give no health.
    pub silent: BTreeSet<String>,
    /// Power that the light monitor reads.
    pub power_w: f64,
}

pub type Shared = Arc<Mutex<World>>;

struct Part {
    name: String,
    world: Shared,
}

struct FakeAxis(Part);
struct FakeWheel(Part);
struct FakeShutter(Part);
struct FakeMonitor(Part);

struct FakeCamera {
    part: Part,
    info: CameraInfo,
    settings: CameraSettings,
    clock: Clock,
    id: u64,
    last: Option<(FrameInfo, Pixels)>,
}

impl Part {
    async fn call(&self) -> Result<()> {
        if self.world.lock().unwrap().hung.contains(&self.name) {
            std::future::pending::<()>().await;
        }
        let panics = self.world.lock().unwrap().panics.take_if(|name| *name == self.name);
        assert_eq!(panics, None, "as the test wants it");
        let mut world = self.world.lock().unwrap();
        let Some(queue) = world.errors.get_mut(&self.name) else { return Ok(()) };
        let Some((kind, left)) = queue.front_mut() else { return Ok(()) };
        let kind = *kind;
        *left -= 1;
        if *left == 0 {
            queue.pop_front();
        }
        Err(DeviceError::new(kind, self.name.clone(), "as the test wants it"))
    }

    fn health(&self) -> Result<Health> {
        let world = self.world.lock().unwrap();
        if world.silent.contains(&self.name) {
            return Err(DeviceError::new(ErrorKind::Timeout, self.name.clone(), "as the test wants it"));
        }
        let warnings = world.contact_open.then(|| "interlock tripped".to_owned()).into_iter().collect();
        Ok(Health { warnings, temperature_c: Some(world.temperature_c) })
    }

    fn identity(&self) -> Identity {
        Identity { model: "fake".into(), firmware: "1".into(), serial: self.name.clone() }
    }

    fn moving(&self) {
        let mut world = self.world.lock().unwrap();
        world.moved_in_light += u32::from(world.open);
    }

    fn safe(&self) {
        self.world.lock().unwrap().safe.push(self.name.clone());
    }
}

#[async_trait]
impl Device for FakeAxis {
    async fn open(&mut self) -> Result<Identity> {
        self.0.call().await.map(|()| self.0.identity())
    }
    async fn health(&mut self) -> Result<Health> {
        Ok(Health::default())
    }
    async fn make_safe(&mut self) -> Result<()> {
        self.0.call().await.map(|()| self.0.safe())
    }
}

#[async_trait]
impl RotaryAxis for FakeAxis {
    fn limits(&self) -> (Degrees, Degrees) {
        (Degrees(0.0), Degrees(360.0))
    }
    fn speed(&self) -> (DegreesPerSecond, f64) {
        (DegreesPerSecond(20.0), 40.0)
    }
    async fn home(&mut self) -> Result<()> {
        let mut world = self.0.world.lock().unwrap();
        world.homed += 1;
        world.lost_place.remove(&self.0.name);
        Ok(())
    }
    async fn move_to(&mut self, target: Degrees) -> Result<Degrees> {
        self.0.call().await?;
        if self.0.world.lock().unwrap().lost_place.contains(&self.0.name) {
            return Err(DeviceError::new(ErrorKind::Broken, self.0.name.clone(), "no reference"));
        }
        self.0.moving();
        tokio::time::sleep(Duration::from_secs(2)).await;
        let mut world = self.0.world.lock().unwrap();
        match self.0.name.as_str() {
            "tilt" => world.tilt = target.0,
            _ => world.spin = target.0,
        }
        Ok(target)
    }
    async fn position(&mut self) -> Result<Option<Degrees>> {
        let world = self.0.world.lock().unwrap();
        let at = if self.0.name == "tilt" { world.tilt } else { world.spin };
        Ok((!world.lost_place.contains(&self.0.name)).then_some(Degrees(at)))
    }
    async fn stop(&mut self) -> Result<()> {
        Ok(())
    }
}

#[async_trait]
impl Device for FakeWheel {
    async fn open(&mut self) -> Result<Identity> {
        self.0.call().await.map(|()| self.0.identity())
    }
    async fn health(&mut self) -> Result<Health> {
        Ok(Health::default())
    }
    async fn make_safe(&mut self) -> Result<()> {
        self.0.call().await?;
        self.0.world.lock().unwrap().slot = Some(DARK_SLOT);
        self.0.safe();
        Ok(())
    }
}

#[async_trait]
impl FilterWheel for FakeWheel {
    fn slots(&self) -> u8 {
        12
    }
    async fn select(&mut self, slot: Slot) -> Result<Slot> {
        self.0.call().await?;
        self.0.moving();
        tokio::time::sleep(Duration::from_secs(1)).await;
        self.0.world.lock().unwrap().slot = Some(slot);
        Ok(slot)
    }
    async fn slot(&mut self) -> Result<Option<Slot>> {
        Ok(self.0.world.lock().unwrap().slot)
    }
}

#[async_trait]
impl Device for FakeShutter {
    async fn open(&mut self) -> Result<Identity> {
        self.0.call().await.map(|()| self.0.identity())
    }
    async fn health(&mut self) -> Result<Health> {
        self.0.health()
    }
    async fn make_safe(&mut self) -> Result<()> {
        self.0.call().await?;
        self.0.world.lock().unwrap().open = false;
        self.0.safe();
        Ok(())
    }
}

#[async_trait]
impl Shutter for FakeShutter {
    async fn set(&mut self, state: ShutterState) -> Result<()> {
        self.0.call().await?;
        self.0.world.lock().unwrap().open = state == ShutterState::Open;
        Ok(())
    }
    async fn state(&mut self) -> Result<Option<ShutterState>> {
        let open = self.0.world.lock().unwrap().open;
        Ok(Some(if open { ShutterState::Open } else { ShutterState::Closed }))
    }
}

#[async_trait]
impl Device for FakeCamera {
    async fn open(&mut self) -> Result<Identity> {
        self.part.call().await?;
        self.id = 0;
        Ok(self.info.identity.clone())
    }
    async fn health(&mut self) -> Result<Health> {
        self.part.health()
    }
    async fn make_safe(&mut self) -> Result<()> {
        self.part.call().await.map(|()| self.part.safe())
    }
}

#[async_trait]
impl Camera for FakeCamera {
    fn info(&self) -> &CameraInfo {
        &self.info
    }
    async fn apply(&mut self, settings: CameraSettings) -> Result<CameraSettings> {
        self.part.call().await?;
        self.settings = settings;
        Ok(settings)
    }
    async fn arm(&mut self) -> Result<Armed> {
        let not_before = self.clock.now();
        Ok(Armed { not_before, discard: 1, due_within: Duration::from_secs(1) })
    }
    async fn next_frame(&mut self) -> Result<Frame> {
        if self.part.world.lock().unwrap().hung.contains(&format!("{}.frame", self.part.name)) {
            std::future::pending::<()>().await;
        }
        self.part.call().await?;
        let number = {
            let mut world = self.part.world.lock().unwrap();
            let count = world.frames.entry(self.part.name.clone()).or_default();
            *count += 1;
            *count
        };
        let wrong = self.part.world.lock().unwrap().wrong.get(&(self.part.name.clone(), number)).copied();
        if let (Some(Wrong::Stale), Some((info, pixels))) = (wrong, self.last.clone()) {
            return Ok(Frame::detached(info, pixels));
        }
        let mut settings = self.settings;
        if wrong == Some(Wrong::OtherExposure) {
            settings.exposure = ExposureTime(settings.exposure.0 * 4);
        }
        self.id += if wrong == Some(Wrong::Skipped) { 2 } else { 1 };
        let start = self.clock.now();
        self.clock.sleep(settings.exposure.duration() + Duration::from_millis(30)).await;
        let mut pixels = self.render(settings.exposure, number);
        if wrong == Some(Wrong::OldPixels) {
            pixels = self.render(ExposureTime(settings.exposure.0 / 4), number);
        }
        if wrong == Some(Wrong::Black) {
            let Pixels::U8(v) = &mut pixels else { unreachable!() };
            v.iter_mut().enumerate().skip(RESERVED * WIDTH).for_each(|(i, p)| *p = (i % 2) as u8);
            v[4] = 0xff;
        }
        let info = FrameInfo {
            camera_serial: self.info.identity.serial.clone(),
            device_frame_id: self.id,
            exposure_start: start,
            received: self.clock.now(),
            utc: self.clock.utc_at(start),
            settings,
            width: WIDTH,
            height: HEIGHT,
            format: PixelFormat::Mono8,
            damaged: wrong == Some(Wrong::Damaged),
        };
        self.last = Some((info.clone(), pixels.clone()));
        Ok(Frame::detached(info, pixels))
    }
    async fn stop(&mut self) -> Result<()> {
        Ok(())
    }
}

#[async_trait]
impl Device for FakeMonitor {
    async fn open(&mut self) -> Result<Identity> {
        Ok(self.0.identity())
    }
    async fn health(&mut self) -> Result<Health> {
        Ok(Health::default())
    }
    async fn make_safe(&mut self) -> Result<()> {
        Ok(())
    }
}

#[async_trait]
impl LightMonitor for FakeMonitor {
    async fn apply(&mut self, wavelength: Nanometres) -> Result<Nanometres> {
        Ok(wavelength)
    }
    async fn read(&mut self) -> Result<LightReading> {
        self.0.health()?;
        let power_w = self.0.world.lock().unwrap().power_w;
        Ok(LightReading { power_w, wavelength: Nanometres(555.0), saturated: false, at: tokio::time::Instant::now() })
    }
}

impl FakeCamera {
    /// Truth in the first bytes (exposure, shutter, slot, tilt), then the response of eq. 4 to a gradient of light.
    fn render(&self, exposure: ExposureTime, number: u32) -> Pixels {
        let world = self.part.world.lock().unwrap();
        let mut levels = vec![0_u8; WIDTH * HEIGHT];
        levels[..4].copy_from_slice(&(exposure.0 as u32).to_le_bytes());
        levels[5] = u8::from(world.open);
        levels[6] = world.slot.map_or(0, |slot| slot.0);
        levels[7] = world.tilt as u8;
        for (i, level) in levels.iter_mut().enumerate().skip(RESERVED * WIDTH) {
            let pattern = 0.2 + (i % 97) as f64 / 60.0;
            let light = if world.open { pattern * (1.0 + world.tilt / 300.0) } else { 0.0 };
            let x = light * exposure.seconds() * 40.0;
            // Another pattern for every frame, or the guard would take two of them for one.
            let mixed = (i as u32 ^ number.wrapping_mul(0x9E37_79B9)).wrapping_mul(2_654_435_761);
            let noise = f64::from((mixed >> 16) % 5) / 1000.0;
            *level = ((0.441_58 * x.powf(0.407_17) - 0.132_54 + noise) * 256.0).clamp(0.0, 255.0) as u8;
        }
        Pixels::U8(levels)
    }
}

/// A bench of two cameras, and its truth.
pub fn bench(clock: Clock) -> (Bench, Shared) {
    let world = Shared::default();
    world.lock().unwrap().lost_place = ["tilt", "spin"].map(str::to_owned).into();
    world.lock().unwrap().power_w = 1e-3;
    let part = |name: &str| Part { name: name.to_owned(), world: Arc::clone(&world) };
    let camera = |name: &str| -> (String, Box<dyn Camera>) {
        let info = CameraInfo {
            identity: part(name).identity(),
            width: WIDTH,
            height: HEIGHT,
            format: PixelFormat::Mono8,
            shortest: ExposureTime(10),
            longest: ExposureTime(60_000_000),
        };
        let settings = CameraSettings { exposure: ExposureTime(1000), gain: 0.0 };
        (name.to_owned(), Box::new(FakeCamera { part: part(name), info, settings, clock, id: 0, last: None }))
    };
    let devices = Devices {
        tilt: Box::new(FakeAxis(part("tilt"))),
        spin: Box::new(FakeAxis(part("spin"))),
        changer: None,
        wheel: Box::new(FakeWheel(part("filter_wheel"))),
        shutter: Box::new(FakeShutter(part("shutter"))),
        cameras: [camera("ccd"), camera("ingaas")].into(),
        light_monitor: Some(Box::new(FakeMonitor(part("light_monitor")))),
        operator: None,
    };
    let axis = AxisCare { settle: Duration::from_millis(300), tolerance_deg: 0.05 };
    let (wheel, shutter) = (Duration::from_millis(200), Duration::from_millis(50));
    (Bench::new(devices, Settle { tilt: axis, spin: axis, changer: axis, wheel, shutter }), world)
}
