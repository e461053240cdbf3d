//! The PM100's command tree.
//!
//! Source: PM100D manual, SCPI chapter.

/// What a command does.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
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
    Measure,
    Initiate,
    Configure,
    Read,
    Fetch,
    Wavelength,
    Average,
    Range,
    AutoRange,
    Unit,
    Zero,
    ZeroState,
    /// A setting that is only kept; with its power-up value.
    Kept(&'static str),
}

use Command::*;

/// Patterns and what they do. One pattern serves setting and query.
#[rustfmt::skip]
pub(super) const COMMANDS: &[(&str, Command)] = &[
    ("*IDN", Identify), ("*CLS", Clear), ("*RST", Reset), ("*WAI", Nothing), ("*TRG", Nothing),
    ("*OPC", Kept("1")), ("*TST", Constant("0")), ("*STB", Constant("0")), ("*ESR", Constant("0")),
    ("*ESE", Kept("0")), ("*SRE", Kept("0")),
    ("SYSTem:SENSor:IDN", Head), ("SYSTem:ERRor:[NEXT]", Error), ("SYSTem:VERSion", Constant("1999.0")),
    ("SYSTem:DATE", Kept("2010,1,10")), ("SYSTem:TIME", Kept("12,0,0")), ("SYSTem:LFRequency", Kept("50")),
    ("SYSTem:BEEPer:STATe", Kept("1")), ("SYSTem:BEEPer:VOLume", Kept("1.000000E+00")), ("SYSTem:BEEPer:[IMMediate]", Nothing),
    ("DISPlay:BRIGhtness", Kept("1.000000E+00")), ("DISPlay:CONTrast", Kept("5.000000E-01")),
    ("CALibration:STRing", Constant("\"10-Jan-2010\"")),
    ("STATus:PRESet", Nothing),
    ("STATus:MEASurement:[EVENt]", Constant("0")), ("STATus:MEASurement:CONDition", Constant("0")), ("STATus:MEASurement:ENABle", Kept("0")),
    ("STATus:AUXiliary:[EVENt]", Constant("0")), ("STATus:AUXiliary:CONDition", Constant("0")), ("STATus:AUXiliary:ENABle", Kept("0")),
    ("STATus:OPERation:[EVENt]", Constant("0")), ("STATus:OPERation:CONDition", Constant("0")), ("STATus:OPERation:ENABle", Kept("0")),
    ("STATus:QUEStionable:[EVENt]", Constant("0")), ("STATus:QUEStionable:CONDition", Constant("0")), ("STATus:QUEStionable:ENABle", Kept("0")),
    ("[SENSe]:AVERage:[COUNt]", Average),
    ("[SENSe]:CORRection:[LOSS]:[INPut]:[MAGNitude]", Kept("0.000000E+00")),
    ("[SENSe]:CORRection:BEAMdiameter", Kept("9.500000E+00")),
    ("[SENSe]:CORRection:COLLect:ZERO:[INITiate]", Zero), ("[SENSe]:CORRection:COLLect:ZERO:ABORt", Nothing),
    ("[SENSe]:CORRection:COLLect:ZERO:STATe", ZeroState), ("[SENSe]:CORRection:COLLect:ZERO:MAGNitude", Constant("0.000000E+00")),
    ("[SENSe]:CORRection:WAVelength", Wavelength),
    ("[SENSe]:CORRection:POWer:[PDIOde]:[RESPonse]", Constant("3.300000E-01")),
    ("[SENSe]:POWer:[DC]:RANGe:AUTO", AutoRange), ("[SENSe]:POWer:[DC]:RANGe:[UPPer]", Range),
    ("[SENSe]:POWer:[DC]:REFerence", Kept("0.000000E+00")), ("[SENSe]:POWer:[DC]:REFerence:STATe", Kept("0")),
    ("[SENSe]:POWer:[DC]:UNIT", Unit),
    ("[SENSe]:CURRent:[DC]:RANGe:AUTO", Kept("1")), ("[SENSe]:CURRent:[DC]:RANGe:[UPPer]", Kept("5.000000E-02")),
    ("[SENSe]:FREQuency:RANGe:[UPPer]", Constant("1.000000E+05")), ("[SENSe]:FREQuency:RANGe:LOWer", Constant("0.000000E+00")),
    ("INPut:[PDIode]:FILTer:[LPASs]:[STATe]", Kept("0")), ("INPut:ADAPter:[TYPE]", Kept("PHOTODIODE")),
    ("CONFigure:[SCALar]:[POWer]", Configure),
    ("MEASure:[SCALar]:[POWer]", Measure), ("INITiate:[IMMediate]", Initiate), ("ABORt", Nothing),
    ("READ", Read), ("FETCh", Fetch),
];
