//! The twin's answers to the ioctls the driver uses; anything else is ENOTTY.

use super::twin::{Done, Fault, Stamps, Twin};
use libc::{c_int, c_ulong, c_void};
use v4l::v4l_sys as c;
use v4l::v4l2::vidioc;

/// Answer of one ioctl: an errno when it fails.
type Answer = Result<(), c_int>;

/// Answers one ioctl of an open file.
///
/// # Safety
/// `argument` points to the structure that belongs to `request`.
pub unsafe fn answer(twin: &mut Twin, fd: c_int, request: c_ulong, argument: *mut c_void) -> Answer {
    if twin.unplugged {
        return Err(libc::ENODEV);
    }
    let writes_control = request == vidioc::VIDIOC_S_CTRL as c_ulong;
    let cost = if writes_control { twin.plan.ioctl_ns.1 } else { twin.plan.ioctl_ns.0 };
    twin.advance(twin.now_ns + cost);
    unsafe {
        match request as vidioc::_IOC_TYPE {
            vidioc::VIDIOC_QUERYCAP => querycap(&mut *argument.cast()),
            vidioc::VIDIOC_ENUM_FMT => twin.enum_format(&mut *argument.cast()),
            vidioc::VIDIOC_S_FMT => twin.set_format(fd, &mut *argument.cast()),
            vidioc::VIDIOC_G_FMT => twin.get_format(&mut *argument.cast()),
            vidioc::VIDIOC_S_PARM => twin.set_interval(&mut *argument.cast()),
            vidioc::VIDIOC_G_PARM => twin.get_interval(&mut *argument.cast()),
            vidioc::VIDIOC_QUERY_EXT_CTRL => twin.query_control(&mut *argument.cast()),
            vidioc::VIDIOC_G_CTRL => twin.get_control(&mut *argument.cast()),
            vidioc::VIDIOC_S_CTRL => twin.set_control(&*argument.cast()),
            vidioc::VIDIOC_G_INPUT => {
                *argument.cast::<c_int>() = 0;
                Ok(())
            }
            vidioc::VIDIOC_ENUMINPUT => {
                (*argument.cast::<c::v4l2_input>()).status = if twin.no_signal { 2 } else { 0 };
                Ok(())
            }
            vidioc::VIDIOC_REQBUFS => twin.request_buffers(fd, &mut *argument.cast()),
            vidioc::VIDIOC_QUERYBUF => twin.query_buffer(&mut *argument.cast()),
            vidioc::VIDIOC_QBUF => twin.queue(&*argument.cast()),
            vidioc::VIDIOC_DQBUF => twin.dequeue(&mut *argument.cast()),
            vidioc::VIDIOC_STREAMON => twin.stream_on(fd),
            vidioc::VIDIOC_STREAMOFF => twin.stream_off(),
            _ => Err(libc::ENOTTY),
        }
    }
}

fn querycap(caps: &mut c::v4l2_capability) -> Answer {
    caps.driver[..4].copy_from_slice(b"twin");
    caps.card[..12].copy_from_slice(b"Kappa DX twi");
    caps.bus_info[..7].copy_from_slice(b"usb-1.2");
    caps.version = 0x0006_0100;
    caps.device_caps = 0x0400_0001;
    caps.capabilities = 0x8400_0001;
    Ok(())
}

// === impl Twin: format, interval, controls ===

impl Twin {
    fn enum_format(&mut self, d: &mut c::v4l2_fmtdesc) -> Answer {
        let code = self.plan.formats.get(d.index as usize).ok_or(libc::EINVAL)?;
        d.pixelformat = u32::from_le_bytes(*code);
        Ok(())
    }

    fn set_format(&mut self, fd: c_int, f: &mut c::v4l2_format) -> Answer {
        if self.owner.is_some_and(|owner| owner != fd) || self.buffers.0 > 0 {
            return Err(libc::EBUSY);
        }
        let asked = unsafe { f.fmt.pix };
        let (most_width, most_height) = self.plan.size;
        let wanted = asked.pixelformat.to_le_bytes();
        let code = if self.plan.formats.contains(&wanted) { wanted } else { self.plan.formats[0] };
        let word = match &code {
            b"RG12" | b"Y10 " | b"Y12 " | b"Y16 " | b"YUYV" => 2,
            b"RGB3" | b"BGR3" => 3,
            _ => 1,
        };
        self.width = asked.width.min(most_width);
        let height = asked.height.min(most_height);
        self.format = (code, self.width as usize * word + self.plan.padding, height as usize, word.min(2));
        self.get_format(f)
    }

    fn get_format(&mut self, f: &mut c::v4l2_format) -> Answer {
        let (code, stride, height, _) = self.format;
        f.fmt.pix = c::v4l2_pix_format {
            width: self.width,
            height: height as u32,
            pixelformat: u32::from_le_bytes(code),
            field: self.plan.field,
            xfer_func: self.plan.transfer,
            bytesperline: stride as u32,
            sizeimage: (stride * height) as u32,
            ..unsafe { std::mem::zeroed() }
        };
        Ok(())
    }

    fn set_interval(&mut self, p: &mut c::v4l2_streamparm) -> Answer {
        if self.plan.interval_busy && self.sensor.streams() {
            return Err(libc::EBUSY);
        }
        let t = unsafe { p.parm.capture.timeperframe };
        let ns = u64::from(t.numerator) * 1_000_000_000 / u64::from(t.denominator.max(1));
        self.sensor.interval_ns = ns.clamp(self.plan.interval_ns.0, self.plan.interval_ns.1);
        // An exposure that no longer fits is cut.
        let exposure = self.controls[&super::twin::EXPOSURE_ABSOLUTE].value;
        if exposure as u64 * 100_000 > self.sensor.interval_ns {
            self.set(super::twin::EXPOSURE_ABSOLUTE, exposure);
        }
        self.get_interval(p)
    }

    fn get_interval(&mut self, p: &mut c::v4l2_streamparm) -> Answer {
        p.parm.capture.timeperframe =
            c::v4l2_fract { numerator: (self.sensor.interval_ns / 1000) as u32, denominator: 1_000_000 };
        Ok(())
    }

    fn query_control(&mut self, q: &mut c::v4l2_query_ext_ctrl) -> Answer {
        let control = self.controls.get(&q.id).ok_or(libc::EINVAL)?;
        (q.minimum, q.maximum) = (i64::from(control.range.0), i64::from(control.range.1));
        (q.step, q.type_) = (1, 1);
        Ok(())
    }

    fn get_control(&mut self, control: &mut c::v4l2_control) -> Answer {
        control.value = self.controls.get(&control.id).ok_or(libc::EINVAL)?.value;
        Ok(())
    }

    fn set_control(&mut self, control: &c::v4l2_control) -> Answer {
        if !self.controls.contains_key(&control.id) {
            return Err(libc::EINVAL);
        }
        self.set(control.id, control.value);
        Ok(())
    }
}

// === impl Twin: buffers ===

impl Twin {
    fn request_buffers(&mut self, fd: c_int, r: &mut c::v4l2_requestbuffers) -> Answer {
        if self.owner.is_some_and(|owner| owner != fd) {
            return Err(libc::EBUSY);
        }
        if r.count == 0 {
            let fails = self.stop_fails;
            self.release();
            return if fails { Err(libc::EIO) } else { Ok(()) };
        }
        let (_, stride, height, _) = self.format;
        let bytes = (stride * height).next_multiple_of(4096);
        r.count = r.count.clamp(2, 8);
        self.buffers = (r.count, bytes);
        self.owner = Some(fd);
        let whole = (bytes * r.count as usize) as libc::off_t;
        if unsafe { libc::ftruncate(fd, whole) } == 0 { Ok(()) } else { Err(libc::ENOMEM) }
    }

    fn query_buffer(&mut self, b: &mut c::v4l2_buffer) -> Answer {
        if b.index >= self.buffers.0 {
            return Err(libc::EINVAL);
        }
        b.length = self.buffers.1 as u32;
        b.m.offset = b.index * b.length;
        Ok(())
    }

    fn queue(&mut self, b: &c::v4l2_buffer) -> Answer {
        if b.index >= self.buffers.0 || self.queued.contains(&b.index) || self.done.iter().any(|d| d.index == b.index) {
            return Err(libc::EINVAL);
        }
        self.queued.push_back(b.index);
        Ok(())
    }

    fn dequeue(&mut self, b: &mut c::v4l2_buffer) -> Answer {
        if self.dequeue_errors.0 > 0 {
            self.dequeue_errors.0 -= 1;
            return Err(self.dequeue_errors.1);
        }
        let done = self.done.pop_front().ok_or(libc::EAGAIN)?;
        self.count(&done);
        b.index = done.index;
        b.bytesused = done.bytesused;
        b.flags = done.flags
            | match self.plan.stamps {
                Stamps::End => 0x2000,
                Stamps::Start => 0x1_2000,
                Stamps::Unknown => 0,
            };
        b.field = self.plan.field;
        b.sequence = done.sequence;
        b.timestamp.tv_sec = (done.stamp_ns / 1_000_000_000) as i64;
        b.timestamp.tv_usec = (done.stamp_ns % 1_000_000_000 / 1000) as i64;
        Ok(())
    }

    fn count(&mut self, done: &Done) {
        self.made.dequeued += 1;
        self.made.lost += done.lost_before;
        match done.fault {
            Some(Fault::Error) => self.made.error += 1,
            Some(Fault::Short) => self.made.short += 1,
            Some(Fault::Twice | Fault::Frozen) => self.made.repeated += 1,
            Some(Fault::Stale) => self.made.stale += 1,
            Some(Fault::Lost) | None => {}
        }
    }

    fn stream_on(&mut self, fd: c_int) -> Answer {
        if self.owner != Some(fd) || self.queued.is_empty() {
            return Err(libc::EINVAL);
        }
        if self.plan.forgets_at_start {
            self.defaults_but_automatics();
        }
        self.sensor.start(self.now_ns);
        Ok(())
    }

    fn defaults_but_automatics(&mut self) {
        for id in [super::twin::EXPOSURE_ABSOLUTE, super::twin::GAIN] {
            let default = self.controls[&id].range.2;
            self.set(id, default);
        }
    }

    fn stream_off(&mut self) -> Answer {
        self.sensor.stop();
        self.queued.clear();
        self.done.clear();
        if self.stop_fails { Err(libc::EIO) } else { Ok(()) }
    }

    /// Writes a picture into the program's buffer and lines it up.
    pub fn fill(&mut self, done: Done, picture: &[u8]) {
        let Some(fd) = self.owner else { return };
        let at = (done.index as usize * self.buffers.1) as libc::off_t;
        let written = unsafe { libc::pwrite(fd, picture.as_ptr().cast(), picture.len(), at) };
        assert_eq!(written, picture.len() as isize, "a twin's buffer takes a whole picture");
        self.done.push_back(done);
    }
}
