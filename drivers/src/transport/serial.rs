//! Serial ports, 8 data bits, no parity, one stop bit, opened by path.

use super::{Connector, FlowControl, Link};
use crate::clock::Clock;
use crate::error::{DeviceError, ErrorKind, Result};
use async_trait::async_trait;
use std::path::Path;
use tokio_serial::SerialPortBuilderExt;

/// Where serial adapters show up under names that survive a replug.
const BY_ID: &str = "/dev/serial/by-id";

/// Opens one serial port by its path.
#[derive(Debug, Clone)]
pub struct SerialConnector {
    path: String,
    baud: u32,
    flow: FlowControl,
    clock: Clock,
}

// === impl SerialConnector ===

impl SerialConnector {
    /// The port at `path` with `baud`, without flow control.
    pub fn new(path: impl Into<String>, baud: u32, clock: Clock) -> SerialConnector {
        SerialConnector { path: path.into(), baud, flow: FlowControl::None, clock }
    }

    /// The same with this flow control.
    pub fn with_flow(self, flow: FlowControl) -> SerialConnector {
        SerialConnector { flow, ..self }
    }
}

#[async_trait]
impl Connector for SerialConnector {
    fn port(&self) -> &str {
        &self.path
    }

    async fn connect(&mut self) -> Result<Link> {
        let flow = match self.flow {
            FlowControl::None => tokio_serial::FlowControl::None,
            FlowControl::RtsCts => tokio_serial::FlowControl::Hardware,
            FlowControl::XonXoff => tokio_serial::FlowControl::Software,
        };
        match tokio_serial::new(&self.path, self.baud).flow_control(flow).open_native_async() {
            Ok(stream) => Ok(Link::new(self.path.clone(), stream, self.clock)),
            Err(cause) => Err(DeviceError::new(ErrorKind::Lost, &self.path, why_not(&self.path, &cause.to_string()))),
        }
    }
}

/// One sentence: what is wrong with `path`, what exists, what to do.
fn why_not(path: &str, cause: &str) -> String {
    if Path::new(path).exists() {
        return format!(
            "serial port {path} is there but cannot be opened ({cause}); close other programs that use it and check that this user belongs to the group dialout"
        );
    }
    let there = ports();
    let list = if there.is_empty() {
        "no serial port exists now".to_owned()
    } else {
        format!("there are {}", there.join(", "))
    };
    format!("serial port {path} is not there ({list}); plug the adapter in or correct `port` in the instrument file")
}

/// Serial ports that exist now: names by id first, else the kernel's names.
fn ports() -> Vec<String> {
    let names = |dir: &str, keep: fn(&str) -> bool| -> Vec<String> {
        let entries = std::fs::read_dir(dir).into_iter().flatten().flatten();
        let mut found: Vec<String> = entries
            .filter(|e| e.file_name().to_str().is_some_and(keep))
            .map(|e| e.path().display().to_string())
            .collect();
        found.sort();
        found
    };
    let by_id = names(BY_ID, |_| true);
    if by_id.is_empty() { names("/dev", |n| n.starts_with("ttyUSB") || n.starts_with("ttyACM")) } else { by_id }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used)]
    use super::*;

    #[tokio::test]
    async fn a_port_that_is_not_there_says_what_to_do() {
        let mut connector = SerialConnector::new("/dev/no-such-port", 115_200, Clock::system());
        let error = connector.connect().await.err().unwrap();
        assert_eq!(error.kind, ErrorKind::Lost);
        assert!(error.message.contains("/dev/no-such-port is not there"), "{error}");
        assert!(error.message.contains("instrument file"), "{error}");
    }

    #[tokio::test]
    async fn a_serial_line_carries_bytes_both_ways_and_its_end_is_a_lost_link() {
        use std::os::fd::AsRawFd;
        use std::time::Duration;
        use tokio::io::{AsyncReadExt, AsyncWriteExt};

        let (mut device, slave) = tokio_serial::SerialStream::pair().unwrap();
        let path = std::fs::read_link(format!("/proc/self/fd/{}", slave.as_raw_fd())).unwrap();
        drop(slave);
        let clock = Clock::system();
        let mut connector = SerialConnector::new(path.display().to_string(), 115_200, clock);
        let mut link = connector.connect().await.unwrap();
        link.send(b"/1 1 06:F8\n").await.unwrap();
        let mut request = [0_u8; 11];
        clock.timeout(Duration::from_secs(5), device.read_exact(&mut request)).await.unwrap().unwrap();
        assert_eq!(&request, b"/1 1 06:F8\n");
        device.write_all(b"@01 1 06 OK IDLE -- 0:06\r\n").await.unwrap();
        let line = link.line(clock.now() + Duration::from_secs(5)).await.unwrap().unwrap();
        assert_eq!(line, b"@01 1 06 OK IDLE -- 0:06");
        drop(device);
        assert_eq!(link.line(clock.now() + Duration::from_secs(5)).await.unwrap_err().kind, ErrorKind::Lost);
    }

    /// A pseudo-terminal keeps what it is told of flow control, though nothing follows from it there.
    #[tokio::test]
    async fn the_line_gets_the_flow_control_that_is_asked_for() {
        use std::os::fd::AsRawFd;
        use tokio_serial::SerialPort;
        let (device, slave) = tokio_serial::SerialStream::pair().unwrap();
        let path = std::fs::read_link(format!("/proc/self/fd/{}", slave.as_raw_fd())).unwrap();
        drop(slave);
        for (flow, kept) in [
            (FlowControl::RtsCts, tokio_serial::FlowControl::Hardware),
            (FlowControl::XonXoff, tokio_serial::FlowControl::Software),
            (FlowControl::None, tokio_serial::FlowControl::None),
        ] {
            let mut connector =
                SerialConnector::new(path.display().to_string(), 19_200, Clock::system()).with_flow(flow);
            let link = connector.connect().await.unwrap();
            assert_eq!(device.flow_control().unwrap(), kept);
            drop(link);
        }
    }

    #[tokio::test]
    async fn a_file_that_is_no_serial_port_is_named_so() {
        let mut connector = SerialConnector::new("/dev/null", 9600, Clock::system());
        let error = connector.connect().await.err().unwrap();
        assert_eq!(error.kind, ErrorKind::Lost);
        assert!(error.message.contains("cannot be opened"), "{error}");
    }
}
