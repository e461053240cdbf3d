//! What is known of each driver beside its code: wire, source, what is assumed, how a power cycle shows, what is never sent.
//! Kept in one place, so that the table of devices can be made from it and a driver without its facts is found.

/// Facts of one driver.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Facts {
    /// Name in the driver table.
    pub driver: &'static str,
    /// Line, framing and checksum.
    pub wire: &'static str,
    /// Manual and protocol sheet.
    pub source: &'static str,
    /// What no manual says: configuration values and pinned constants that a bench measurement may correct.
    pub assumed: &'static str,
    /// How a power cycle is noticed.
    pub power_cycle: &'static str,
    /// Commands of the device that the driver cannot say.
    pub never_sent: &'static str,
}

/// The facts of the driver called `name`; `None` for a driver that nobody wrote down.
pub fn of(name: &str) -> Option<&'static Facts> {
    FACTS.iter().find(|facts| facts.driver == name)
}

const ESP: Facts = Facts {
    driver: "newport-esp301",
    wire: "USB serial 921,600 baud 8N1; ASCII lines, an error queue instead of answers, no checksum: two answers must agree",
    source: "ESP301 user's manual, command chapter; sheet newport-esp301",
    assumed: "a home search may seem to rest between its phases (three rests, 200 ms apart, end it); move margin 3 s; a position is commanded twice at most",
    power_cycle: "the motor is off without our doing",
    never_sent: "SM (save), RS (restart), SA (address), ZA ZB ZE ZF ZH ZS and Q writes, stored programs",
};

/// All facts, in the order of the table.
pub const FACTS: &[Facts] = &[
    Facts {
        driver: "zaber-ascii",
        wire: "serial 115,200 baud 8N1; ASCII lines with message id and LRC checksum both ways",
        source: "Zaber ASCII protocol manual (firmware 6 and 7); sheet zaber-ascii",
        assumed: "silence after a wrong checksum; `OK IDLE` for a move of no length; one request outstanding; move margin 3 s; soft limits in the configuration",
        power_cycle: "the uptime went back, the reference is gone (WR)",
        never_sent: "renumber, comm.address, comm.rs232.baud, resolution, peripheral.id, system restore, storage, firmware words",
    },
    ESP,
    Facts { driver: "newport-esp300", wire: "RS-232 19,200 baud 8N1; else as newport-esp301", ..ESP },
    Facts {
        driver: "newport-smc100",
        wire: "serial 57,600 baud 8N1, one address a box; ASCII lines, answers only to questions, no checksum: two answers must agree",
        source: "SMC100 user's manual, command chapter; sheet newport-smc100",
        assumed: "60 ms after a command without answer; the stage's identifier holds its serial number; units of the stage are degrees",
        power_cycle: "state 0A, not referenced; a NUL on the line",
        never_sent: "PW1 and PW0 (configuration mode, writes the flash), RS (restart), SA (address), PR (relative move)",
    },
    Facts {
        driver: "thorlabs-fw212c",
        wire: "serial 115,200 baud 8N1; ASCII, echo and prompt, no checksum: echo and a second answer must agree",
        source: "FW102C/FW212C manual Rev H, command chapter; sheet thorlabs-fw212c",
        assumed: "the wheel finds itself at power-up; one place takes 0.5 to 1 s; settling 100 ms in the configuration",
        power_cycle: "its position sensors shine again (`sensors?` is the stored value); bytes without a request",
        never_sent: "pcount=, baud=, save, trig=, ESC (arrow keys)",
    },
    Facts {
        driver: "optec-ifw",
        wire: "serial 19,200 baud 8N1; ASCII, answers end with LF CR, no checksum: place and error must agree",
        source: "IFW technical manual 17350; sheet optec-ifw",
        assumed: "requests end with LF CR; home search 40 s and a turn 20 s at most; the wheel's letter stands for a serial number",
        power_cycle: "serial mode is left: it is silent until WSMODE, and is homed again",
        never_sent: "WLOAD (writes names into the flash)",
    },
    Facts {
        driver: "thorlabs-sc10",
        wire: "serial 9600 baud 8N1; ASCII, echo and prompt, no checksum: sensor and state must agree",
        source: "SC10 manual 8654-D02, command page; sheet thorlabs-sc10-shutter",
        assumed: "closed and not enabled after power-up; blade 200 ms at most; after a trip the interlock needs a new enable; settling in the configuration",
        power_cycle: "closed and not enabled, mode as stored; the state is asked before every toggle",
        never_sent: "baud, save, savp, resp, default; `ens` without asking before",
    },
    Facts {
        driver: "uniblitz-vcm-d1",
        wire: "serial 9600 baud 8N1; one byte an order, never an answer",
        source: "VCM-D1 manual; sheet uniblitz-vcm-d1",
        assumed: "35 ms of travel; the order twice, 50 ms apart; a device that answers is another device",
        power_cycle: "none on the wire: the pictures must show it",
        never_sent: "anything but open and close of channel 1 (no trigger, no address)",
    },
    Facts {
        driver: "lcus-relay",
        wire: "USB serial (CH340) 9600 baud 8N1; four bytes with a sum, never an answer",
        source: "vendor pages of the board family; sheet usb-relay-lcus",
        assumed: "50 ms of travel behind the contact; the order twice, 50 ms apart; all channels off at power-up",
        power_cycle: "none on the wire: the pictures must show it",
        never_sent: "anything but on and off of channel 1",
    },
    Facts {
        driver: "spectral-cm110",
        wire: "serial 9600 baud 8N1; binary, read by length, no checksum: two answers must agree",
        source: "CM110/112 manual, command chapter; sheet spectralproducts-cm110",
        assumed: "slowest slew 20 nm/s; from below by 5 nm; reach 1200 nm at 1200 grooves/mm; the 24 after a rejection may be missing",
        power_cycle: "units are nanometres again; position 0",
        never_sent: "ZERO, INC, DEC, CALIBRATE, RESET, SELECT, SCAN",
    },
    Facts {
        driver: "thorlabs-pm100",
        wire: "USBTMC 1.0, SCPI; READ? counts when head and wavelength are the known ones and FETC? repeats it",
        source: "PM100D and PM100USB manuals, SCPI chapters; sheet thorlabs-pm100-usbtmc",
        assumed: "product id of the PM100A; 9.9E+37 is overrange; ten times the manual's 3 ms a sample",
        power_cycle: "it leaves the bus; wavelength, average and unit are not what was set",
        never_sent: "*RST, calibration and adapter commands, zeroing",
    },
    Facts {
        driver: "newport-1830c",
        wire: "serial 9600 baud 8N1; ASCII, settings not answered, no checksum: settings twice, power as median of three to five",
        source: "1830-C manual as quoted by public clients; sheet thorlabs-pm100-usbtmc, section 4",
        assumed: "lockout is off after power-up; four digits of wavelength; one disturbed answer in six at most",
        power_cycle: "lockout, units, filter or wavelength are not what was set",
        never_sent: "O (auto-calibration), Z1 (zero), S (reference)",
    },
    Facts {
        driver: "oceanoptics-usb",
        wire: "USB bulk, binary; slots and status until two answers agree, a spectrum by length and sync byte",
        source: "OEM data sheets of USB2000, USB2000+ and USB4000; sheet oceanoptics-usb2000",
        assumed: "order of the status words (both are understood); 0x01 may leave a spectrum; dark pixels of USB2000+ and USB4000",
        power_cycle: "it leaves the bus; integration time and trigger mode are not what was set",
        never_sent: "0x06 (write slot), 0x07 (write serial), 0x04 (shutdown)",
    },
    Facts {
        driver: "v4l2",
        wire: "ioctls of the kernel's V4L2 interface; every frame by number, time stamp and flags",
        source: "kernel V4L2 documentation; sheet ccd-v4l2-kappa-dx20; docs/cameras.md",
        assumed: "control ids, units and latency are declared in the instrument file, never guessed",
        power_cycle: "the node goes; controls are read back with every setting",
        never_sent: "controls that the instrument file does not name",
    },
    Facts {
        driver: "aravis",
        wire: "GigE Vision UDP or USB3 Vision with GenICam; every frame by block id, time stamp and status",
        source: "GigE Vision and GenICam SFNC as Aravis has them; sheet ingaas-genicam-gige-su320; docs/cameras.md",
        assumed: "trigger latency and discarded frames are declared in the instrument file",
        power_cycle: "heartbeat and control are lost; settings are read back",
        never_sent: "UserSetSave, DeviceReset, IP configuration",
    },
];

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used)]
    use super::*;
    use crate::table::{BY_FEATURE, DRIVERS};

    #[test]
    fn every_driver_has_its_facts_and_every_fact_its_driver() {
        for driver in DRIVERS {
            let facts = of(driver.name).unwrap_or_else(|| panic!("{} has no facts", driver.name));
            let all = [facts.wire, facts.source, facts.assumed, facts.power_cycle, facts.never_sent];
            assert!(all.iter().all(|text| !text.is_empty() && !text.contains('|')), "{}", driver.name);
        }
        for facts in FACTS {
            let known = DRIVERS.iter().any(|d| d.name == facts.driver);
            assert!(known || BY_FEATURE.iter().any(|(name, _)| *name == facts.driver), "{}", facts.driver);
        }
    }

    /// What is said of the lines agrees with the table.
    #[test]
    fn the_baud_rate_of_every_serial_line_is_in_its_facts() {
        for driver in DRIVERS.iter().filter(|d| d.baud > 0) {
            let wire = of(driver.name).map_or("", |f| f.wire).replace(',', "");
            assert!(wire.contains(&format!("{} baud", driver.baud)), "{}: {wire}", driver.name);
        }
    }
}
