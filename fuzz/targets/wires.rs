//! Targets: every driver on a line of the table, with a device behind the wire that says what the input says.
//!
//! An input is a sequence of answers, each with its length in two bytes before it (low byte first); one answer a request.
//! On USB an answer begins with a byte for how the transfer ends. After the last answer there is silence.

use super::harness::Target;
use super::session::{Wire, paused, session};
use async_trait::async_trait;
use goniod_drivers::clock::Clock;
use goniod_drivers::error::Result as Answer;
use goniod_drivers::transport::usb::{BulkEndpoint, Transfer, UsbConnector, UsbError, UsbInfo, UsbPipe, UsbRequest};
use goniod_drivers::transport::{Connector, Link, UsbLink};
use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use tokio::io::{AsyncReadExt, AsyncWriteExt};

/// One target a driver.
macro_rules! targets {
    ($($name:literal $wire:ident $mutations:literal),+ $(,)?) => {
        /// All of them.
        pub const TARGETS: &[Target] =
            &[$(Target { name: concat!("wire-", $name), run: |bytes| $wire($name, bytes), mutations: $mutations }),+];
    };
}

targets!(
    "zaber-ascii" line 60,
    "newport-esp301" line 60,
    "newport-esp300" line 30,
    "newport-smc100" line 60,
    "thorlabs-fw212c" line 100,
    "optec-ifw" line 100,
    "thorlabs-sc10" line 100,
    "uniblitz-vcm-d1" line 30,
    "lcus-relay" line 30,
    "spectral-cm110" line 100,
    "newport-1830c" line 100,
    "thorlabs-pm100" usb 100,
    "oceanoptics-usb" usb 60,
);

/// Answers that wait, shared by all connections.
#[derive(Clone)]
struct Script(Arc<Mutex<VecDeque<Vec<u8>>>>);

/// A serial port behind which the script answers.
struct Port(Script, Clock);

/// A USB device that answers by the script.
struct Bus(Script, UsbInfo);

/// An open one.
struct Pipe(Script, Clock);

fn line(driver: &str, bytes: &[u8]) -> Result<(), String> {
    paused().block_on(async {
        let port = Port(Script::read(bytes), Clock::system());
        session(driver, Wire::Line(Box::new(port))).await
    })
}

fn usb(driver: &str, bytes: &[u8]) -> Result<(), String> {
    let endpoint = |address, packet| BulkEndpoint { address, packet };
    let (vendor, product, class, endpoints) = match driver {
        "oceanoptics-usb" => {
            (0x2457, 0x1002, (255, 0, 0), vec![endpoint(2, 64), endpoint(0x82, 64), endpoint(0x87, 64)])
        }
        _ => (0x1313, 0x8078, (254, 3, 1), vec![endpoint(2, 64), endpoint(0x82, 64)]),
    };
    let info = UsbInfo { vendor, product, class, endpoints, serial: "P0001234".to_owned(), ..UsbInfo::default() };
    paused().block_on(async { session(driver, Wire::Usb(Box::new(Bus(Script::read(bytes), info)))).await })
}

// === impl Script ===

impl Script {
    fn read(mut bytes: &[u8]) -> Script {
        let mut answers = VecDeque::new();
        while let Some((length, rest)) = bytes.split_first_chunk::<2>() {
            let (answer, rest) = rest.split_at(usize::from(u16::from_le_bytes(*length)).min(rest.len()));
            answers.push_back(answer.to_vec());
            bytes = rest;
        }
        Script(Arc::new(Mutex::new(answers)))
    }

    fn next(&self) -> Option<Vec<u8>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).pop_front()
    }
}

#[async_trait]
impl Connector for Port {
    fn port(&self) -> &str {
        "script"
    }

    async fn connect(&mut self) -> Answer<Link> {
        let (near, mut far) = tokio::io::duplex(8192);
        let script = self.0.clone();
        tokio::spawn(async move {
            let mut request = [0; 256];
            while let Ok(1..) = far.read(&mut request).await {
                if far.write_all(&script.next().unwrap_or_default()).await.is_err() {
                    return;
                }
            }
        });
        Ok(Link::new("script", near, self.1))
    }
}

#[async_trait]
impl UsbConnector for Bus {
    fn port(&self) -> &str {
        "script"
    }

    async fn connect(&mut self) -> Answer<UsbLink> {
        Ok(UsbLink::new(Pipe(self.0.clone(), Clock::system()), self.1.clone()))
    }
}

#[async_trait]
impl UsbPipe for Pipe {
    async fn transfer(&mut self, request: UsbRequest, limit: Duration) -> Transfer<Vec<u8>> {
        let room = match request {
            UsbRequest::BulkIn(_, room) | UsbRequest::ControlIn(_, room) => room,
            _ => return Ok(Vec::new()),
        };
        let answer = self.0.next();
        match answer.as_deref() {
            Some([0, bytes @ ..]) if bytes.len() > room => Err(UsbError::Overflow),
            Some([0, bytes @ ..]) => Ok(bytes.to_vec()),
            Some([2, ..]) => Err(UsbError::Stall),
            Some([3, ..]) => Err(UsbError::Gone),
            _ => {
                self.1.sleep(limit).await;
                Err(UsbError::Timeout)
            }
        }
    }
}
