//! The twin's outside: plan, controls with their tempers, buffers and their queues.

use super::paint::Dice;
use super::sensor::Sensor;
use std::collections::{BTreeMap, VecDeque};

/// Control ids of the twin.
pub const EXPOSURE_AUTO: u32 = 0x009A_0901;
/// Unit 100 us.
pub const EXPOSURE_ABSOLUTE: u32 = 0x009A_0902;
/// Automatic gain.
pub const AUTOGAIN: u32 = 0x0098_0912;
/// Gain.
pub const GAIN: u32 = 0x0098_0913;
/// Gamma in hundredths.
pub const GAMMA: u32 = 0x0098_0910;

/// Which stamp the twin puts on its pictures.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stamps {
    /// Monotonic, end of frame.
    End,
    /// Monotonic, start of exposure.
    Start,
    /// None that means anything.
    Unknown,
}

/// What kind of camera the twin is.
#[derive(Debug, Clone)]
pub struct Plan {
    /// Formats on offer.
    pub formats: Vec<[u8; 4]>,
    /// Largest columns and rows; other sizes are adjusted to these.
    pub size: (u32, u32),
    /// Bytes added to each line.
    pub padding: usize,
    /// Kind of stamps.
    pub stamps: Stamps,
    /// Read-out time.
    pub readout_ns: u64,
    /// Shortest and longest frame interval.
    pub interval_ns: (u64, u64),
    /// Least and most frames until a written value is fully in force.
    pub latency: (u64, u64),
    /// The last frame before a value is in force is exposed with the old above and the new below.
    pub half_changed: bool,
    /// One picture in so many gets a fault; 0 = none.
    pub fault_every: u64,
    /// Virtual time an ioctl takes, and writing a control.
    pub ioctl_ns: (u64, u64),
    /// Real time for each poll, so that the reader keeps up.
    pub pace_us: u32,
    /// The frame interval cannot change while streaming.
    pub interval_busy: bool,
    /// Controls fall back to their defaults at STREAMON.
    pub forgets_at_start: bool,
    /// Writing this control seems to work and changes nothing.
    pub stubborn: Option<u32>,
    /// Field order that pictures have (1 = progressive, 4 = interlaced).
    pub field: u32,
    /// Transfer function that pictures have (0 = default, 2 = sRGB).
    pub transfer: u32,
    /// Seed of everything random.
    pub seed: u64,
}

/// One control.
#[derive(Debug, Clone, Copy)]
pub struct Control {
    /// Smallest, largest and default value.
    pub range: (i32, i32, i32),
    /// What it reads.
    pub value: i32,
}

/// A filled buffer that waits.
#[derive(Debug, Clone, Copy)]
pub struct Done {
    /// Which buffer.
    pub index: u32,
    /// Sequence number.
    pub sequence: u32,
    /// Stamp in ns.
    pub stamp_ns: u64,
    /// Bytes filled.
    pub bytesused: u32,
    /// Extra flags.
    pub flags: u32,
    /// The fault made with it.
    pub fault: Option<Fault>,
    /// Pictures lost just before it.
    pub lost_before: u64,
}

/// Faults the twin makes by itself.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Fault {
    /// A picture never comes.
    Lost,
    /// Flag ERROR, lower half missing.
    Error,
    /// Fewer bytes than a picture.
    Short,
    /// The same buffer contents, number and stamp come twice.
    Twice,
    /// An older buffer comes again after a newer.
    Stale,
    /// The previous picture under a new number and stamp.
    Frozen,
}

/// Faults that reached the program.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Made {
    /// Pictures given out.
    pub dequeued: u64,
    /// Numbers that never came.
    pub lost: u64,
    /// Flagged as corrupt.
    pub error: u64,
    /// Too short.
    pub short: u64,
    /// Came twice, or an old picture under a new number.
    pub repeated: u64,
    /// Older than one before.
    pub stale: u64,
}

/// A camera.
#[derive(Debug)]
pub struct Twin {
    /// What it is.
    pub plan: Plan,
    /// Its own clock.
    pub now_ns: u64,
    /// Its controls.
    pub controls: BTreeMap<u32, Control>,
    /// The sensor.
    pub sensor: Sensor,
    /// Format in force: code, line bytes, rows, word bytes.
    pub format: ([u8; 4], usize, usize, usize),
    /// Columns in force.
    pub width: u32,
    /// Pulled out: every call fails, the node is gone.
    pub unplugged: bool,
    /// The input has no signal.
    pub no_signal: bool,
    /// The next so many DQBUF fail with this errno.
    pub dequeue_errors: (u32, i32),
    /// STREAMOFF and REQBUFS 0 fail with EIO.
    pub stop_fails: bool,
    /// The next ioctl hangs for this real time.
    pub hang_us: u32,
    /// How often it was opened.
    pub opens: u32,
    /// Faults that reached the program.
    pub made: Made,
    /// Dice for everything random.
    pub dice: Dice,
    /// Owner of the buffers, their file and memory.
    pub owner: Option<i32>,
    /// Buffers given: count, bytes each.
    pub buffers: (u32, usize),
    /// Empty buffers of the program.
    pub queued: VecDeque<u32>,
    /// Filled buffers.
    pub done: VecDeque<Done>,
}

// === impl Plan ===

impl Default for Plan {
    fn default() -> Plan {
        Plan {
            formats: vec![*b"YUYV", *b"RGGB"],
            size: (64, 48),
            padding: 0,
            stamps: Stamps::End,
            readout_ns: 30_000_000,
            interval_ns: (40_000_000, 10_000_000_000),
            latency: (2, 2),
            half_changed: true,
            fault_every: 0,
            ioctl_ns: (50_000, 50_000),
            pace_us: 50,
            interval_busy: false,
            forgets_at_start: false,
            stubborn: None,
            field: 1,
            transfer: 0,
            seed: 1,
        }
    }
}

// === impl Twin ===

impl Twin {
    /// A camera as it comes out of its box: everything automatic.
    pub fn new(plan: Plan) -> Twin {
        let control = |low, high, default| Control { range: (low, high, default), value: default };
        let controls = BTreeMap::from([
            (EXPOSURE_AUTO, control(0, 3, 3)),
            (EXPOSURE_ABSOLUTE, control(1, 100_000, 200)),
            (AUTOGAIN, control(0, 1, 1)),
            (GAIN, control(0, 63, 8)),
            (GAMMA, control(50, 300, 200)),
        ]);
        Twin {
            now_ns: 800_000_000_000,
            dice: Dice::new(plan.seed),
            sensor: Sensor::new(plan.interval_ns.0),
            format: (plan.formats[0], 0, 0, 1),
            width: 0,
            controls,
            unplugged: false,
            no_signal: false,
            dequeue_errors: (0, 0),
            stop_fails: false,
            hang_us: 0,
            opens: 0,
            made: Made::default(),
            owner: None,
            buffers: (0, 0),
            queued: VecDeque::new(),
            done: VecDeque::new(),
            plan,
        }
    }

    /// Back in its socket, with everything at its defaults again.
    pub fn plug_again(&mut self) {
        self.unplugged = false;
        self.defaults();
    }

    /// All controls at their defaults.
    pub fn defaults(&mut self) {
        for id in self.controls.keys().copied().collect::<Vec<_>>() {
            let default = self.controls[&id].range.2;
            self.set(id, default);
        }
    }

    /// Writes a control as the device takes it: clamped, or ignored.
    pub fn set(&mut self, id: u32, wanted: i32) {
        let automatic = self.controls[&AUTOGAIN].value != 0;
        if self.plan.stubborn == Some(id) || (id == GAIN && automatic) {
            return;
        }
        let longest = (self.sensor.interval_ns / 100_000) as i32;
        let Some(control) = self.controls.get_mut(&id) else { return };
        let mut value = wanted.clamp(control.range.0, control.range.1);
        if id == EXPOSURE_ABSOLUTE {
            value = value.min(longest.max(1));
        }
        control.value = value;
        if id == EXPOSURE_ABSOLUTE || id == GAIN {
            let (least, most) = self.plan.latency;
            let frames = least + self.dice.below(most - least + 1);
            self.sensor.write(id == GAIN, value as u32, frames);
        }
    }

    /// A file was closed: its buffers are free.
    pub fn closed(&mut self, fd: i32) {
        if self.owner == Some(fd) {
            self.release();
        }
    }

    /// Stops and forgets all buffers.
    pub fn release(&mut self) {
        self.sensor.stop();
        self.owner = None;
        self.buffers = (0, 0);
        self.queued.clear();
        self.done.clear();
    }

    /// Turns the clock to the next picture or by the time-out; the poll events there.
    pub fn poll(&mut self, timeout_ms: i32) -> i16 {
        let limit = self.now_ns + timeout_ms.max(0) as u64 * 1_000_000;
        loop {
            if self.unplugged || !self.sensor.streams() {
                return libc::POLLERR;
            }
            if !self.done.is_empty() || self.dequeue_errors.0 > 0 {
                return libc::POLLIN;
            }
            match self.sensor.next_event().filter(|at| *at <= limit) {
                Some(at) => self.advance(at),
                None => {
                    self.advance(limit);
                    return 0;
                }
            }
        }
    }
}
