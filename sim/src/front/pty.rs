//! A twin behind a pseudo-terminal under a stable name, in real time: any program that opens serial ports can use it.
//!
//! The front serves the twin of a [`PipePort`], whose faults and plug it shares. A program may close the port and open
//! it again; `unplug` takes the name away as pulling an adapter does, `plug` brings it back with another number behind it.

use super::pipe::{PipePort, State};
use crate::firmware::Firmware;
use goniod_drivers::clock::Clock;
use rustix::fd::{AsFd, OwnedFd};
use rustix::fs::{Mode, OFlags};
use rustix::io::Errno;
use rustix::pty::OpenptFlags;
use rustix::termios::OptionalActions;
use std::io;
use std::path::{Path, PathBuf};
use std::time::Duration;
use tokio::sync::watch;
use tokio::task::JoinHandle;
use tokio::time::Instant;

/// How often an unused port looks for a program that opened it, and a used one for bytes.
const LOOK: Duration = Duration::from_millis(10);
const LISTEN: Duration = Duration::from_millis(2);

/// A port in the file system with a twin behind it, until it is dropped.
pub struct PtyPort {
    task: JoinHandle<()>,
    path: PathBuf,
}

/// One pseudo-terminal and the link that names it.
struct Pty {
    master: OwnedFd,
    path: PathBuf,
    /// What the link names.
    target: PathBuf,
}

// === impl PtyPort ===

impl PtyPort {
    /// Puts the twin of `port` behind the name `path`; an old link of that name is replaced. Needs a tokio runtime.
    ///
    /// # Errors
    /// No pseudo-terminal can be had, or the link cannot be made.
    pub fn open<T: Firmware>(path: impl Into<PathBuf>, port: &PipePort<T>, clock: Clock) -> io::Result<PtyPort> {
        let path = path.into();
        let first = Pty::open(&path)?;
        let task = tokio::spawn(serve(first, port.clone(), clock));
        Ok(PtyPort { task, path })
    }

    /// The name.
    pub fn path(&self) -> &Path {
        &self.path
    }
}

impl Drop for PtyPort {
    fn drop(&mut self) {
        self.task.abort();
    }
}

// === impl Pty ===

impl Pty {
    fn open(path: &Path) -> io::Result<Pty> {
        let master = rustix::pty::openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY)?;
        rustix::pty::grantpt(&master)?;
        rustix::pty::unlockpt(&master)?;
        let name = rustix::pty::ptsname(&master, Vec::new())?;
        // Raw from the start; the settings of a pseudo-terminal live as long as its master. Opened and closed once, so
        // that a port nobody uses reads as hung up.
        let slave = rustix::fs::open(name.as_c_str(), OFlags::RDWR | OFlags::NOCTTY | OFlags::CLOEXEC, Mode::empty())?;
        let mut settings = rustix::termios::tcgetattr(&slave)?;
        settings.make_raw();
        rustix::termios::tcsetattr(&slave, OptionalActions::Now, &settings)?;
        drop(slave);
        rustix::fs::fcntl_setfl(&master, OFlags::RDWR | OFlags::NONBLOCK)?;
        match std::fs::remove_file(path) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
            _ => {}
        }
        let target = name.to_str().map_err(|_| io::Error::from(io::ErrorKind::InvalidData))?;
        std::os::unix::fs::symlink(target, path)?;
        Ok(Pty { master, path: path.to_owned(), target: target.into() })
    }

    /// What a program has written: some bytes, nothing at present, or `Err` while nobody has the port open.
    fn read(&self, chunk: &mut [u8]) -> Result<Option<usize>, ()> {
        match rustix::io::read(self.master.as_fd(), chunk) {
            Ok(0) => Err(()),
            Ok(n) => Ok(Some(n)),
            Err(Errno::AGAIN | Errno::INTR) => Ok(None),
            Err(_) => Err(()),
        }
    }

    /// Hands over what fits; what a program does not take is lost, as on a serial line.
    fn write(&self, bytes: &[u8]) {
        let mut rest = bytes;
        while let Ok(n) = rustix::io::write(self.master.as_fd(), rest)
            && n > 0
            && n < rest.len()
        {
            rest = rest.get(n..).unwrap_or_default();
        }
    }
}

impl Drop for Pty {
    fn drop(&mut self) {
        // The name may be gone already, or another's by now; there is nobody to tell.
        if std::fs::read_link(&self.path).is_ok_and(|target| target == self.target) {
            let _ = std::fs::remove_file(&self.path);
        }
    }
}

/// Carries bytes for as long as the port lives, with a new pseudo-terminal after each replug.
async fn serve<T: Firmware>(first: Pty, port: PipePort<T>, clock: Clock) {
    let mut changes = port.changes();
    let path = first.path.clone();
    let mut pty = first;
    loop {
        carry(&pty, &port, &mut changes, clock).await;
        drop(pty);
        while !changes.borrow_and_update().plugged {
            if changes.changed().await.is_err() {
                return;
            }
        }
        pty = match Pty::open(&path) {
            Ok(next) => next,
            Err(error) => {
                tracing::error!(path = %path.display(), %error, "the simulated port cannot be put back");
                return;
            }
        };
    }
}

/// Carries bytes until the adapter is pulled.
async fn carry<T: Firmware>(pty: &Pty, port: &PipePort<T>, changes: &mut watch::Receiver<State>, clock: Clock) {
    let mut used = false;
    let mut chunk = [0_u8; 256];
    while changes.borrow_and_update().plugged {
        let read = pty.read(&mut chunk);
        let now = Instant::now();
        if read.is_ok() && !used {
            port.twin().connected(now);
        }
        used = read.is_ok();
        if let Ok(Some(n)) = read {
            port.twin().receive(chunk.get(..n).unwrap_or_default(), now);
            continue;
        }
        if used {
            let bytes = port.twin().take(now);
            pty.write(&bytes);
        }
        let due = port.twin().due().filter(|_| used);
        let look = now + if used { LISTEN } else { LOOK };
        tokio::select! {
            () = clock.sleep_until(due.map_or(look, |due| due.min(look))) => {}
            _ = changes.changed() => {}
        }
    }
}
