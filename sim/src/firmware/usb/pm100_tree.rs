//! The PM100's command tree.
//!
//! Source: PM100D manual, SCPI chapter.

/// What is measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Quantity {
    /// Radiant power, W or dBm.
    Power,
    /// Photocurrent, A.
    Current,
    /// Power over the area of the beam, W/cm2.
    PowerDensity,
    /// How often the light comes, Hz; none here, it is steady.
    Frequency,
    /// What a photodiode cannot give: voltage, energy, its density, resistance, temperature.
    Other(&'static str),
}

/// What a command does.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Command {
    Identify,
    Head,
    Error,
    /// A query with a fixed answer.
    Constant(&'static str),
    Clear,
    Reset,
    /// Taken, changes nothing that can be seen.
    Nothing,
    Measure(Quantity),
    Initiate,
    Configure(Quantity),
    Configured,
    Read,
    Fetch,
    Wavelength,
    Average,
    Range,
    AutoRange,
    Unit,
    Zero,
    ZeroState,
    /// The status byte, without reading an answer.
    StatusByte,
    /// The event register, which reading clears.
    EventStatus,
    /// A setting that is only kept; with its power-up value.
    Kept(&'static str),
    /// A number that is only kept; power-up value, least, most.
    KeptNumber(f64, f64, f64),
}

// === impl Quantity ===

impl Quantity {
    /// What `CONFigure?` says.
    pub(super) fn name(self) -> &'static str {
        match self {
            Quantity::Power => "POW",
            Quantity::Current => "CURR",
            Quantity::PowerDensity => "PDEN",
            Quantity::Frequency => "FREQ",
            Quantity::Other(name) => name,
        }
    }
}

use Command::*;
use Quantity::{Current, Frequency, Other, Power, PowerDensity};

/// Patterns and what they do. One pattern serves setting and query.
#[rustfmt::skip]
pub(super) const COMMANDS: &[(&str, Command)] = &[
    ("*IDN", Identify), ("*CLS", Clear), ("*RST", Reset), ("*WAI", Nothing), ("*TRG", Nothing),
    ("*OPC", Kept("1")), ("*TST", Constant("0")), ("*STB", StatusByte), ("*ESR", EventStatus),
    ("*ESE", Kept("0")), ("*SRE", Kept("0")),
    ("SYSTem:SENSor:IDN", Head), ("SYSTem:ERRor:[NEXT]", Error), ("SYSTem:VERSion", Constant("1999.0")),
    ("SYSTem:DATE", Kept("2010,1,10")), ("SYSTem:TIME", Kept("12,0,0")), ("SYSTem:LFRequency", Kept("50")),
    ("SYSTem:BEEPer:STATe", Kept("1")), ("SYSTem:BEEPer:VOLume", KeptNumber(1.0, 0.0, 1.0)), ("SYSTem:BEEPer:[IMMediate]", Nothing),
    ("DISPlay:BRIGhtness", KeptNumber(1.0, 0.0, 1.0)), ("DISPlay:CONTrast", KeptNumber(0.5, 0.0, 1.0)),
    ("CALibration:STRing", Constant("\"10-Jan-2010\"")),
    ("STATus:PRESet", Nothing),
    ("STATus:MEASurement:[EVENt]", Constant("0")), ("STATus:MEASurement:CONDition", Constant("0")), ("STATus:MEASurement:ENABle", Kept("0")),
    ("STATus:MEASurement:PTRansition", Kept("32767")), ("STATus:MEASurement:NTRansition", Kept("0")),
    ("STATus:AUXiliary:[EVENt]", Constant("0")), ("STATus:AUXiliary:CONDition", Constant("0")), ("STATus:AUXiliary:ENABle", Kept("0")),
    ("STATus:AUXiliary:PTRansition", Kept("32767")), ("STATus:AUXiliary:NTRansition", Kept("0")),
    ("STATus:OPERation:[EVENt]", Constant("0")), ("STATus:OPERation:CONDition", Constant("0")), ("STATus:OPERation:ENABle", Kept("0")),
    ("STATus:OPERation:PTRansition", Kept("32767")), ("STATus:OPERation:NTRansition", Kept("0")),
    ("STATus:QUEStionable:[EVENt]", Constant("0")), ("STATus:QUEStionable:CONDition", Constant("0")), ("STATus:QUEStionable:ENABle", Kept("0")),
    ("STATus:QUEStionable:PTRansition", Kept("32767")), ("STATus:QUEStionable:NTRansition", Kept("0")),
    ("[SENSe]:AVERage:[COUNt]", Average),
    ("[SENSe]:CORRection:[LOSS]:[INPut]:[MAGNitude]", KeptNumber(0.0, -60.0, 60.0)),
    ("[SENSe]:CORRection:BEAMdiameter", KeptNumber(9.5, 0.1, 25.4)),
    ("[SENSe]:CORRection:COLLect:ZERO:[INITiate]", Zero), ("[SENSe]:CORRection:COLLect:ZERO:ABORt", Nothing),
    ("[SENSe]:CORRection:COLLect:ZERO:STATe", ZeroState), ("[SENSe]:CORRection:COLLect:ZERO:MAGNitude", Constant("0.000000E+00")),
    ("[SENSe]:CORRection:WAVelength", Wavelength),
    ("[SENSe]:CORRection:POWer:[PDIOde]:[RESPonse]", KeptNumber(0.33, 1e-3, 1e3)),
    ("[SENSe]:CORRection:POWer:THERmopile:[RESPonse]", KeptNumber(0.1, 1e-6, 1e3)),
    ("[SENSe]:CORRection:ENERgy:[PYRO]:[RESPonse]", KeptNumber(1.0, 1e-3, 1e6)),
    ("[SENSe]:POWer:[DC]:RANGe:AUTO", AutoRange), ("[SENSe]:POWer:[DC]:RANGe:[UPPer]", Range),
    ("[SENSe]:POWer:[DC]:REFerence", KeptNumber(0.0, -1e3, 1e3)), ("[SENSe]:POWer:[DC]:REFerence:STATe", Kept("0")),
    ("[SENSe]:POWer:[DC]:UNIT", Unit),
    ("[SENSe]:CURRent:[DC]:RANGe:AUTO", Kept("1")), ("[SENSe]:CURRent:[DC]:RANGe:[UPPer]", KeptNumber(5e-3, 50e-9, 5e-3)),
    ("[SENSe]:CURRent:[DC]:REFerence", KeptNumber(0.0, -1.0, 1.0)), ("[SENSe]:CURRent:[DC]:REFerence:STATe", Kept("0")),
    ("[SENSe]:VOLTage:[DC]:RANGe:AUTO", Kept("1")), ("[SENSe]:VOLTage:[DC]:RANGe:[UPPer]", KeptNumber(1.0, 1e-3, 1.0)),
    ("[SENSe]:VOLTage:[DC]:REFerence", KeptNumber(0.0, -10.0, 10.0)), ("[SENSe]:VOLTage:[DC]:REFerence:STATe", Kept("0")),
    ("[SENSe]:ENERgy:RANGe:[UPPer]", KeptNumber(1.0, 1e-6, 1e3)),
    ("[SENSe]:ENERgy:REFerence", KeptNumber(0.0, -1e3, 1e3)), ("[SENSe]:ENERgy:REFerence:STATe", Kept("0")),
    ("[SENSe]:FREQuency:RANGe:[UPPer]", Constant("1.000000E+05")), ("[SENSe]:FREQuency:RANGe:LOWer", Constant("0.000000E+00")),
    ("[SENSe]:PEAKdetector:[THReshold]", KeptNumber(50.0, 1.0, 99.0)),
    ("INPut:[PDIode]:FILTer:[LPASs]:[STATe]", Kept("0")), ("INPut:ADAPter:[TYPE]", Kept("PHOTODIODE")),
    ("INPut:THERmopile:ACCelerator:[STATe]", Kept("0")), ("INPut:THERmopile:ACCelerator:AUTO", Kept("0")),
    ("INPut:THERmopile:TAU", KeptNumber(1.0, 1e-3, 1e3)),
    ("CONFigure", Configured),
    ("CONFigure:[SCALar]:[POWer]", Configure(Power)), ("CONFigure:[SCALar]:CURRent:[DC]", Configure(Current)),
    ("CONFigure:[SCALar]:PDENsity", Configure(PowerDensity)), ("CONFigure:[SCALar]:FREQuency", Configure(Frequency)),
    ("CONFigure:[SCALar]:VOLTage:[DC]", Configure(Other("VOLT"))), ("CONFigure:[SCALar]:ENERgy", Configure(Other("ENER"))),
    ("CONFigure:[SCALar]:EDENsity", Configure(Other("EDEN"))), ("CONFigure:[SCALar]:RESistance", Configure(Other("RES"))),
    ("CONFigure:[SCALar]:TEMPerature", Configure(Other("TEMP"))),
    ("MEASure:[SCALar]:[POWer]", Measure(Power)), ("MEASure:[SCALar]:CURRent:[DC]", Measure(Current)),
    ("MEASure:[SCALar]:PDENsity", Measure(PowerDensity)), ("MEASure:[SCALar]:FREQuency", Measure(Frequency)),
    ("MEASure:[SCALar]:VOLTage:[DC]", Measure(Other("VOLT"))), ("MEASure:[SCALar]:ENERgy", Measure(Other("ENER"))),
    ("MEASure:[SCALar]:EDENsity", Measure(Other("EDEN"))), ("MEASure:[SCALar]:RESistance", Measure(Other("RES"))),
    ("MEASure:[SCALar]:TEMPerature", Measure(Other("TEMP"))),
    ("INITiate:[IMMediate]", Initiate), ("ABORt", Nothing),
    ("READ", Read), ("FETCh", Fetch),
];
