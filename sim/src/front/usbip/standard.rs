//! The standard requests of chapter 9 (USB 2.0 specification, 9.4), answered from a device's descriptors. Pure.

use crate::front::usb::{Answer, Descriptors, SetupPacket, Speed};
use std::collections::{BTreeMap, BTreeSet};

const GET_STATUS: u8 = 0;
const CLEAR_FEATURE: u8 = 1;
const SET_FEATURE: u8 = 3;
const SET_ADDRESS: u8 = 5;
const GET_DESCRIPTOR: u8 = 6;
const GET_CONFIGURATION: u8 = 8;
const SET_CONFIGURATION: u8 = 9;
const GET_INTERFACE: u8 = 10;
const SET_INTERFACE: u8 = 11;
const ENDPOINT_HALT: u16 = 0;

/// A request on endpoint 0, sorted.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Sorted {
    /// Answered here.
    Answered(Answer),
    /// Done here; the twin must know that this endpoint works again.
    Cleared(u8),
    /// Done here; the twin must know that it was configured.
    Configured,
    /// For the twin.
    ForTwin,
}

/// What the host has set by standard requests.
#[derive(Debug)]
pub struct Standard {
    descriptors: Descriptors,
    configuration: u8,
    alternates: BTreeMap<u8, u8>,
    halted: BTreeSet<u8>,
}

/// The descriptors inside a configuration, one after another; ends at the first that is broken.
pub fn parts(configuration: &[u8]) -> impl Iterator<Item = &[u8]> {
    let mut rest = configuration;
    std::iter::from_fn(move || {
        let length = usize::from(*rest.first()?);
        let part = rest.get(..length).filter(|_| length >= 2)?;
        rest = rest.get(length..)?;
        Some(part)
    })
}

// === impl Standard ===

impl Standard {
    /// A device that has just been plugged in.
    pub fn new(descriptors: Descriptors) -> Standard {
        Standard { descriptors, configuration: 0, alternates: BTreeMap::new(), halted: BTreeSet::new() }
    }

    /// The endpoint is halted.
    pub fn is_halted(&self, endpoint: u8) -> bool {
        self.halted.contains(&endpoint)
    }

    /// Halts an endpoint until the host clears it; endpoint 0 never stays halted.
    pub fn halt(&mut self, endpoint: u8) {
        if endpoint & 0x0f != 0 {
            self.halted.insert(endpoint);
        }
    }

    /// Sorts a request and answers it where it is a standard one.
    pub fn request(&mut self, setup: SetupPacket) -> Sorted {
        // A standard GET_DESCRIPTOR to an interface asks for a class descriptor.
        let recipient = setup.request_type & 0x1f;
        if setup.request_type & 0x60 != 0 || (setup.request == GET_DESCRIPTOR && recipient != 0) {
            return Sorted::ForTwin;
        }
        let endpoint = setup.index as u8;
        match setup.request {
            GET_STATUS => Sorted::Answered(Answer::Data(self.status(recipient, endpoint))),
            CLEAR_FEATURE if recipient == 2 && setup.value == ENDPOINT_HALT => {
                self.halted.remove(&endpoint);
                Sorted::Cleared(endpoint)
            }
            SET_FEATURE if recipient == 2 && setup.value == ENDPOINT_HALT => {
                self.halt(endpoint);
                Sorted::Answered(Answer::Data(Vec::new()))
            }
            SET_ADDRESS => Sorted::Answered(Answer::Data(Vec::new())),
            GET_DESCRIPTOR => Sorted::Answered(self.descriptor(setup.value)),
            GET_CONFIGURATION => Sorted::Answered(Answer::Data(vec![self.configuration])),
            SET_CONFIGURATION => self.configure(setup.value as u8),
            GET_INTERFACE => Sorted::Answered(match self.alternates.get(&endpoint) {
                Some(alternate) => Answer::Data(vec![*alternate]),
                None if self.has_interface(endpoint, 0) => Answer::Data(vec![0]),
                None => Answer::Stall,
            }),
            SET_INTERFACE => Sorted::Answered(self.select(endpoint, setup.value as u8)),
            _ => Sorted::Answered(Answer::Stall),
        }
    }

    fn status(&self, recipient: u8, endpoint: u8) -> Vec<u8> {
        let low = match recipient {
            0 => self.descriptors.configuration.get(7).copied().unwrap_or(0) >> 6 & 1,
            2 => u8::from(self.halted.contains(&endpoint)),
            _ => 0,
        };
        vec![low, 0]
    }

    fn configure(&mut self, value: u8) -> Sorted {
        if value != 0 && self.descriptors.configuration.get(5) != Some(&value) {
            return Sorted::Answered(Answer::Stall);
        }
        self.configuration = value;
        self.halted.clear();
        self.alternates.clear();
        Sorted::Configured
    }

    fn has_interface(&self, number: u8, alternate: u8) -> bool {
        parts(&self.descriptors.configuration)
            .any(|d| d.get(1) == Some(&4) && d.get(2) == Some(&number) && d.get(3) == Some(&alternate))
    }

    /// Selects an alternate setting; its endpoints then start without halt.
    fn select(&mut self, interface: u8, alternate: u8) -> Answer {
        if !self.has_interface(interface, alternate) {
            return Answer::Stall;
        }
        self.alternates.insert(interface, alternate);
        let mut inside = false;
        for part in parts(&self.descriptors.configuration) {
            match (part.get(1), part.get(2)) {
                (Some(4), Some(number)) => inside = *number == interface,
                (Some(5), Some(endpoint)) if inside => {
                    self.halted.remove(endpoint);
                }
                _ => {}
            }
        }
        Answer::Data(Vec::new())
    }

    fn descriptor(&self, value: u16) -> Answer {
        let (kind, index) = ((value >> 8) as u8, usize::from(value as u8));
        let d = &self.descriptors;
        match (kind, index) {
            (1, 0) => Answer::Data(d.device.clone()),
            (2, 0) => Answer::Data(d.configuration.clone()),
            (3, 0) => Answer::Data(vec![4, 3, 0x09, 0x04]),
            (3, _) => d.strings.get(index - 1).map_or(Answer::Stall, |text| Answer::Data(string(text))),
            (6, 0) if d.speed == Speed::High => Answer::Data(qualifier(&d.device)),
            _ => Answer::Stall,
        }
    }
}

/// A string descriptor; a descriptor's length byte leaves room for 126 UTF-16 units.
fn string(text: &str) -> Vec<u8> {
    let units: Vec<u16> = text.encode_utf16().take(126).collect();
    let mut out = vec![2 + 2 * units.len() as u8, 3];
    out.extend(units.into_iter().flat_map(u16::to_le_bytes));
    out
}

/// What the device would be at the other speed: the same, with one configuration.
fn qualifier(device: &[u8]) -> Vec<u8> {
    let mut out = vec![10, 6];
    out.extend(device.get(2..8).unwrap_or_default());
    out.resize(8, 0);
    out.extend([1, 0]);
    out
}
