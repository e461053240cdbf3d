//! The PM100's answers as values: identity of meter and head, numbers, error queue.
//!
//! Source: PM100D manual, SCPI chapter: `*IDN?`, `SYSTem:SENSor:IDN?`, `SYSTem:ERRor?`, number formats.

/// Flag of a head that measures power.
const POWER: u16 = 1;
/// Flag of a head whose wavelength can be set.
const WAVELENGTH: u16 = 32;

/// `THORLABS,PM100D,P0001234,2.4.0`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Meter {
    pub(super) model: String,
    pub(super) serial: String,
    pub(super) firmware: String,
}

/// `S120VC,12345,10-Jan-2010,1,1,33`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Head {
    pub(super) name: String,
    pub(super) serial: String,
    pub(super) flags: u16,
    /// The whole answer.
    pub(super) text: String,
}

// === impl Meter ===

impl Meter {
    pub(super) fn parse(text: &str) -> Option<Meter> {
        let fields: Vec<&str> = text.split(',').map(str::trim).collect();
        let [maker, model, serial, firmware] = *fields.as_slice() else { return None };
        let plain = |t: &str| !t.is_empty() && t.bytes().all(|b| b.is_ascii_graphic());
        let ours = maker.eq_ignore_ascii_case("THORLABS") && model.starts_with("PM100");
        (ours && [model, serial, firmware].into_iter().all(plain)).then(|| Meter {
            model: model.to_owned(),
            serial: serial.to_owned(),
            firmware: firmware.to_owned(),
        })
    }
}

// === impl Head ===

impl Head {
    /// `None` when no head is plugged in or the text is not that of a head.
    pub(super) fn parse(text: &str) -> Option<Head> {
        let fields: Vec<&str> = text.split(',').map(|f| f.trim().trim_matches('"')).collect();
        let [name, serial, _calibration, kind, subtype, flags] = *fields.as_slice() else { return None };
        let whole = kind.parse::<u16>().is_ok() && subtype.parse::<u16>().is_ok();
        let none = name.is_empty() || name.eq_ignore_ascii_case("no sensor");
        (whole && !none).then_some(())?;
        Some(Head {
            name: name.to_owned(),
            serial: serial.to_owned(),
            flags: flags.parse().ok()?,
            text: text.to_owned(),
        })
    }

    pub(super) fn measures_power(&self) -> bool {
        self.flags & POWER != 0
    }

    pub(super) fn wavelength_settable(&self) -> bool {
        self.flags & WAVELENGTH != 0
    }
}

/// A finite number in decimal notation, with or without exponent: no names, no blanks inside, at most 24 characters.
pub(super) fn number(text: &str) -> Option<f64> {
    let text = text.trim();
    let plain = text.len() <= 24 && text.bytes().all(|b| b.is_ascii_digit() || b"+-.eE".contains(&b));
    plain.then(|| text.parse().ok()).flatten().filter(|n: &f64| n.is_finite())
}

/// True for `+0,"No error"`, false for any other entry of the error queue, `None` for what is no entry.
pub(super) fn no_error(text: &str) -> Option<bool> {
    let (code, words) = text.split_once(',')?;
    let code: i32 = code.trim().parse().ok()?;
    let quoted = words.trim().strip_prefix('"')?.strip_suffix('"')?;
    Some(code == 0 && quoted.eq_ignore_ascii_case("no error"))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used)]
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn answers_are_those_of_the_sheet() {
        let meter = Meter::parse("THORLABS,PM100D,P0001234,2.4.0").unwrap();
        assert_eq!((meter.model.as_str(), meter.serial.as_str()), ("PM100D", "P0001234"));
        assert!(Meter::parse("NEWPORT,1830-C,1,2").is_none() && Meter::parse("THORLABS,PM100D").is_none());
        let head = Head::parse("S120VC,12345,10-Jan-2010,1,1,33").unwrap();
        assert_eq!((head.serial.as_str(), head.flags), ("12345", 33));
        assert!(head.measures_power() && head.wavelength_settable());
        assert!(Head::parse("no sensor").is_none() && Head::parse("no sensor,,,0,0,0").is_none());
        assert_eq!(number("1.234567E-04"), Some(1.234567e-4));
        assert_eq!([number("nan"), number("inf"), number("1 2"), number(""), number("1e999")], [None; 5]);
        assert_eq!(no_error("+0,\"No error\""), Some(true));
        assert_eq!(no_error("-113,\"Undefined header\""), Some(false));
        assert_eq!(no_error("1.0E-3"), None);
    }

    proptest! {
        #[test]
        fn any_text_is_read_or_refused(text in "[ -~]{0,48}") {
            let _ = (Meter::parse(&text), Head::parse(&text), no_error(&text));
            prop_assert!(number(&text).is_none_or(f64::is_finite));
        }
    }
}
