//! The doors: `open`, `close`, `poll` and `syscall` as C sees them. Everything not for a twin goes on to the C library.

use super::ioctl;
use super::twin::Twin;
use libc::{c_char, c_int, c_long, c_void};
use std::cell::RefCell;
use std::collections::BTreeMap;
use std::ffi::CStr;
use std::sync::atomic::{AtomicBool, AtomicPtr, Ordering};
use std::sync::{Arc, Mutex, MutexGuard};

/// Twins by node path, and by open file.
static NODES: Mutex<BTreeMap<String, Arc<Mutex<Twin>>>> = Mutex::new(BTreeMap::new());
static FILES: Mutex<BTreeMap<c_int, Arc<Mutex<Twin>>>> = Mutex::new(BTreeMap::new());
/// Looked at before any lock is taken: most calls are not for us.
static OURS: [AtomicBool; 1024] = [const { AtomicBool::new(false) }; 1024];

thread_local! {
    /// The twin whose clock this thread sees: that of the camera it opened.
    static CLOCK: RefCell<Option<Arc<Mutex<Twin>>>> = const { RefCell::new(None) };
}

/// Plugs a twin in under a node path.
pub fn plug(path: &str, twin: Twin) -> Arc<Mutex<Twin>> {
    let twin = Arc::new(Mutex::new(twin));
    locked(&NODES).insert(path.to_owned(), Arc::clone(&twin));
    twin
}

/// A lock that a failed assertion elsewhere does not spoil.
pub fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(|e| e.into_inner())
}

fn file(fd: c_int) -> Option<Arc<Mutex<Twin>>> {
    let ours = usize::try_from(fd).ok().and_then(|i| OURS.get(i))?;
    if !ours.load(Ordering::Acquire) {
        return None;
    }
    locked(&FILES).get(&fd).cloned()
}

fn fail(errno: c_int) -> c_int {
    unsafe { *libc::__errno_location() = errno };
    -1
}

/// The next definition of a function after ours: the C library's.
fn real(cache: &AtomicPtr<c_void>, name: &CStr) -> *mut c_void {
    let known = cache.load(Ordering::Acquire);
    if !known.is_null() {
        return known;
    }
    let found = unsafe { libc::dlsym(libc::RTLD_NEXT, name.as_ptr()) };
    assert!(!found.is_null(), "the C library has no {name:?}");
    cache.store(found, Ordering::Release);
    found
}

fn real_syscall() -> unsafe extern "C" fn(c_long, ...) -> c_long {
    static REAL: AtomicPtr<c_void> = AtomicPtr::new(std::ptr::null_mut());
    unsafe { std::mem::transmute(real(&REAL, c"syscall")) }
}

/// C's `open`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn open(path: *const c_char, flags: c_int, mode: c_int) -> c_int {
    static REAL: AtomicPtr<c_void> = AtomicPtr::new(std::ptr::null_mut());
    let name = unsafe { CStr::from_ptr(path) }.to_str().unwrap_or("");
    let Some(twin) = locked(&NODES).get(name).cloned() else {
        type Open = unsafe extern "C" fn(*const c_char, c_int, ...) -> c_int;
        let real: Open = unsafe { std::mem::transmute(real(&REAL, c"open")) };
        return unsafe { real(path, flags, mode) };
    };
    let mut inside = locked(&twin);
    if inside.unplugged {
        return fail(libc::ENOENT);
    }
    let fd = unsafe { libc::memfd_create(c"twin".as_ptr(), libc::MFD_CLOEXEC) };
    if fd < 0 {
        return fd;
    }
    inside.opens += 1;
    drop(inside);
    locked(&FILES).insert(fd, Arc::clone(&twin));
    OURS[fd as usize].store(true, Ordering::Release);
    CLOCK.with(|clock| *clock.borrow_mut() = Some(twin));
    fd
}

/// C's `close`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn close(fd: c_int) -> c_int {
    static REAL: AtomicPtr<c_void> = AtomicPtr::new(std::ptr::null_mut());
    if let Some(twin) = file(fd) {
        OURS[fd as usize].store(false, Ordering::Release);
        locked(&FILES).remove(&fd);
        locked(&twin).closed(fd);
    }
    let real: unsafe extern "C" fn(c_int) -> c_int = unsafe { std::mem::transmute(real(&REAL, c"close")) };
    unsafe { real(fd) }
}

/// C's `poll`: for a twin its clock runs to the next picture, or by the time-out.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn poll(fds: *mut libc::pollfd, count: libc::nfds_t, timeout_ms: c_int) -> c_int {
    static REAL: AtomicPtr<c_void> = AtomicPtr::new(std::ptr::null_mut());
    if count == 1
        && let Some(twin) = file(unsafe { (*fds).fd })
    {
        let (events, pace_us) = {
            let mut inside = locked(&twin);
            (inside.poll(timeout_ms), inside.plan.pace_us)
        };
        unsafe { libc::usleep(pace_us) };
        unsafe { (*fds).revents = events };
        return c_int::from(events != 0);
    }
    type Poll = unsafe extern "C" fn(*mut libc::pollfd, libc::nfds_t, c_int) -> c_int;
    let real: Poll = unsafe { std::mem::transmute(real(&REAL, c"poll")) };
    unsafe { real(fds, count, timeout_ms) }
}

/// C's `syscall`: the way crate `v4l` takes for its ioctls, and the driver for the clock of its stamps.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn syscall(
    number: c_long,
    a: c_long,
    b: c_long,
    c: c_long,
    d: c_long,
    e: c_long,
    f: c_long,
) -> c_long {
    if number == libc::SYS_ioctl
        && let Some(twin) = file(a as c_int)
    {
        let hang_us = std::mem::take(&mut locked(&twin).hang_us);
        if hang_us > 0 {
            unsafe { libc::usleep(hang_us) };
        }
        let outcome = unsafe { ioctl::answer(&mut locked(&twin), a as c_int, b as libc::c_ulong, c as *mut c_void) };
        return outcome.map_or_else(|errno| c_long::from(fail(errno)), |()| 0);
    }
    if number == libc::SYS_clock_gettime && a == c_long::from(libc::CLOCK_MONOTONIC) {
        let twin = CLOCK.try_with(|clock| clock.borrow().clone()).ok().flatten();
        if let Some(twin) = twin {
            let now = locked(&twin).now_ns;
            unsafe {
                *(b as *mut libc::timespec) = libc::timespec {
                    tv_sec: (now / 1_000_000_000) as libc::time_t,
                    tv_nsec: (now % 1_000_000_000) as c_long,
                }
            };
            return 0;
        }
    }
    unsafe { real_syscall()(number, a, b, c, d, e, f) }
}
