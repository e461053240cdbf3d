//! `[daemon]` of the instrument file: where `goniod serve` listens and keeps its queue.

use super::error::{Issue, Severity};
use super::source::Source;
use serde::{Deserialize, Serialize};
use std::net::SocketAddr;
use std::path::PathBuf;

/// Bytes that the path of a Unix socket has at most (sun_path, unix(7)), the socket's name while it is made included.
const LONGEST_SOCKET: usize = 103;

/// Where the daemon lives; every key has a default.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Daemon {
    /// Unix socket of the control API.
    pub socket: Option<PathBuf>,
    /// Loopback address and port of the live page, read only.
    pub listen: Option<String>,
    /// Folder of the queue.
    pub state_dir: Option<PathBuf>,
}

// === impl Daemon ===

impl Daemon {
    /// The address of the live page.
    pub fn address(&self) -> Option<SocketAddr> {
        self.listen.as_ref()?.parse().ok()
    }

    /// Refuses an address that is none, or that other machines could reach.
    pub fn check(&self, source: &Source, issues: &mut Vec<Issue>) {
        let socket = self.socket.as_ref().map_or(0, |path| path.as_os_str().len());
        if socket > LONGEST_SOCKET {
            let key = "daemon.socket";
            let message = format!(
                "`{key}` has {socket} bytes; a Unix socket's path has at most {LONGEST_SOCKET}, choose a shorter one"
            );
            issues.push(source.issue(Severity::Error, key, message));
        }
        let key = "daemon.listen";
        let Some(listen) = &self.listen else { return };
        let hint = "write a loopback address with its port, such as \"127.0.0.1:8080\"";
        let why = match listen.parse::<SocketAddr>() {
            Ok(address) if address.ip().is_loopback() => return,
            Ok(_) => "other machines could reach it, and the page asks nobody for a password",
            Err(_) => "it is no address",
        };
        issues.push(source.issue(Severity::Error, key, format!("`{key}` is \"{listen}\": {why}; {hint}")));
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used)]
    use super::*;
    use std::path::Path;

    #[test]
    fn a_socket_longer_than_the_kernel_takes_is_refused() {
        let check = |n: usize| {
            let path = format!("/{}", "s".repeat(n - 1));
            let source = Source::parse(Path::new("i.toml"), format!("[daemon]\nsocket = \"{path}\"\n")).unwrap();
            let mut issues = Vec::new();
            Daemon { socket: Some(path.into()), ..Daemon::default() }.check(&source, &mut issues);
            issues.len()
        };
        assert_eq!((check(LONGEST_SOCKET), check(LONGEST_SOCKET + 1)), (0, 1));
    }

    fn faults(listen: &str) -> Vec<Issue> {
        let text = format!("[daemon]\nlisten = \"{listen}\"\n");
        let source = Source::parse(Path::new("i.toml"), text).unwrap();
        let mut issues = Vec::new();
        Daemon { listen: Some(listen.to_owned()), ..Daemon::default() }.check(&source, &mut issues);
        issues
    }

    #[test]
    fn the_page_is_for_this_machine_only() {
        for good in ["127.0.0.1:8080", "[::1]:9000", "127.0.0.1:0"] {
            assert!(faults(good).is_empty(), "{good}");
        }
        for bad in ["0.0.0.0:80", "192.168.1.4:8080", "localhost:8080", "8080", ""] {
            let found = faults(bad);
            assert_eq!((found.len(), found[0].line), (1, 2), "{bad}");
            assert!(found[0].message.contains("127.0.0.1:8080"));
        }
    }
}
