//! SCPI's grammar: program messages into headers and parameters, header patterns with long and short forms.
//!
//! Source: SCPI-1999 volume 1, chapters 5 to 7; IEEE 488.2.

/// One command of a message.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Unit {
    /// Header in upper case, without leading colon and question mark.
    pub header: String,
    /// It asks.
    pub query: bool,
    /// Parameters, in upper case outside quotes.
    pub parameters: Vec<String>,
    /// It begins with a colon or an asterisk: the path of the command before it does not count.
    pub absolute: bool,
}

/// Splits a message at its semicolons, not within quotes.
pub fn units(message: &str) -> Vec<Unit> {
    let mut quoted = false;
    let parts = message.split(|c| {
        quoted ^= c == '"';
        c == ';' && !quoted
    });
    parts.map(str::trim).filter(|part| !part.is_empty()).map(unit).collect()
}

fn unit(text: &str) -> Unit {
    let (header, rest) = text.split_once(char::is_whitespace).unwrap_or((text, ""));
    let absolute = header.starts_with([':', '*']);
    let header = header.trim_start_matches(':').to_ascii_uppercase();
    let (header, query) = match header.strip_suffix('?') {
        Some(header) => (header.to_owned(), true),
        None => (header, false),
    };
    let parameters = rest.split(',').map(|p| p.trim().to_ascii_uppercase()).filter(|p| !p.is_empty()).collect();
    Unit { header, query, parameters, absolute }
}

/// True when `header` is one of the forms of `pattern`: `[SENSe]:CORRection:WAVelength`. Nodes in brackets may be left
/// out, the letters in upper case are the short form, a `1` may follow any node.
pub fn matches(pattern: &str, header: &str) -> bool {
    let nodes: Vec<&str> = pattern.split(':').collect();
    let words: Vec<&str> = header.split(':').collect();
    fit(&nodes, &words)
}

fn fit(nodes: &[&str], words: &[&str]) -> bool {
    let Some((node, nodes)) = nodes.split_first() else { return words.is_empty() };
    let optional = node.starts_with('[');
    let name = node.trim_matches(['[', ']']);
    let taken = words.split_first().is_some_and(|(word, words)| is_form(name, word) && fit(nodes, words));
    taken || (optional && fit(nodes, words))
}

fn is_form(name: &str, word: &str) -> bool {
    let short: String = name.chars().filter(|c| !c.is_ascii_lowercase()).collect();
    let long = name.to_ascii_uppercase();
    [word, word.strip_suffix('1').unwrap_or(word)].iter().any(|w| **w == short || **w == long)
}

/// A number as the instrument writes it: `1.234567E-04`.
pub fn number(value: f64) -> String {
    let text = format!("{value:.6E}");
    match text.split_once('E') {
        Some((digits, exponent)) => {
            let (sign, size) = exponent.strip_prefix('-').map_or(('+', exponent), |size| ('-', size));
            format!("{digits}E{sign}{size:0>2}")
        }
        None => text,
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used)]
    use super::*;

    #[test]
    fn headers_have_long_and_short_forms_and_nodes_that_may_be_left_out() {
        let pattern = "[SENSe]:CORRection:WAVelength";
        for header in ["SENS:CORR:WAV", "SENSE:CORRECTION:WAVELENGTH", "CORR:WAV", "SENS1:CORR:WAV"] {
            assert!(matches(pattern, header), "{header}");
        }
        for header in ["SENS:CORR", "SENS:CORR:WAVE", "CORR:WAV:X", "", "SENSE"] {
            assert!(!matches(pattern, header), "{header}");
        }
        assert!(matches("[SENSe]:POWer:[DC]:RANGe:[UPPer]", "POW:RANG"));
        assert!(matches("[SENSe]:POWer:[DC]:RANGe:[UPPer]", "SENSE:POWER:DC:RANGE:UPPER"));
    }

    #[test]
    fn a_message_has_commands_with_parameters() {
        let units = units(" :sens:corr:wav 550 ; *idn?;SENS:CORR:WAV? max;");
        assert_eq!(units.len(), 3);
        assert_eq!(
            (units[0].header.as_str(), units[0].parameters.as_slice()),
            ("SENS:CORR:WAV", &["550".to_owned()][..])
        );
        assert!(units[0].absolute && units[1].query && units[1].header == "*IDN" && !units[2].absolute);
        assert_eq!(units[2].parameters, ["MAX"]);
    }

    #[test]
    fn numbers_have_six_digits_and_a_signed_exponent() {
        assert_eq!(number(1.234567e-4), "1.234567E-04");
        assert_eq!(number(550.0), "5.500000E+02");
        assert_eq!(number(-2.5e-10), "-2.500000E-10");
        assert_eq!(number(9.9e37), "9.900000E+37");
    }
}
