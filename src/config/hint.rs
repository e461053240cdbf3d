//! Sentences for what is wrong with a key or its value: what, what is allowed, what to write.

use super::schema::{self, Kind, Schema};
use toml::de::DeValue;

/// Suffix of keys, word for their unit, spellings of units of the kind with the factor to it.
type Unit = (&'static str, &'static str, &'static [(&'static str, f64)]);

/// The units that key names state.
const UNITS: [Unit; 6] = [
    (
        "_s",
        "seconds",
        &[("s", 1.0), ("sec", 1.0), ("ms", 1e-3), ("us", 1e-6), ("µs", 1e-6), ("min", 60.0), ("h", 3600.0)],
    ),
    ("_deg", "degrees", &[("deg", 1.0), ("°", 1.0), ("rad", 180.0 / std::f64::consts::PI)]),
    ("_mm", "millimetres", &[("mm", 1.0), ("cm", 10.0), ("m", 1000.0), ("um", 1e-3), ("µm", 1e-3)]),
    ("_nm", "nanometres", &[("nm", 1.0), ("um", 1000.0), ("µm", 1000.0)]),
    ("_deg_per_s", "degrees per second", &[("deg/s", 1.0)]),
    ("_px", "pixels", &[("px", 1.0), ("pixel", 1.0), ("pixels", 1.0)]),
];

/// An unknown key: the nearest allowed ones, a key of the same meaning in another unit, or the table it belongs to.
pub fn unknown_key(schema: &Schema, pattern: &str, table: &str, key: &str) -> String {
    let place = place(table);
    let allowed: Vec<&str> = schema::children(schema, pattern).map(|(name, _)| name).collect();
    if let Some((to, word, factor)) = same_in_other_unit(&allowed, key) {
        let unit = key.rsplit('_').next().unwrap_or(key);
        let example = trimmed(factor);
        return format!(
            "`{key}` is not a key of {place}; {word} are meant here: write `{to}` (1 {unit} is {example} {word})"
        );
    }
    if let Some(near) = nearest(key, allowed.iter().copied()) {
        return format!("`{key}` is not a key of {place}; did you mean `{near}`?");
    }
    let elsewhere = homes(schema, key);
    if !elsewhere.is_empty() {
        return format!("`{key}` is not a key of {place}; it belongs into {}", elsewhere.join(" or "));
    }
    if let Some((word, family)) = same_family(&allowed, key) {
        return format!("`{key}` is not a key of {place}; {word} are written in {}", quoted(&family));
    }
    format!("`{key}` is not a key of {place}; allowed are {}", quoted(&allowed))
}

/// The allowed key that an unknown one is meant to be, where that can be told.
pub fn meant<'a>(schema: &'a Schema, pattern: &'a str, key: &str) -> Option<&'a str> {
    let allowed: Vec<&str> = schema::children(schema, pattern).map(|(name, _)| name).collect();
    same_in_other_unit(&allowed, key).map(|(to, ..)| to).or_else(|| nearest(key, allowed.iter().copied()))
}

/// A key that must be there.
pub fn missing_key(schema: &Schema, pattern: &str, table: &str, key: &str, kind: &Kind) -> String {
    let what = match kind {
        Kind::Table | Kind::Map => {
            let below = super::source::join(pattern, key);
            let keys: Vec<&str> = schema::children(schema, &below).map(|(name, _)| name).collect();
            let full = super::source::join(table, key);
            return if keys.is_empty() || keys == ["*"] {
                format!("the table [{full}] is missing; add it")
            } else {
                format!("the table [{full}] is missing; add it with {}", quoted(&keys))
            };
        }
        other => wanted(key, other),
    };
    format!("`{key}` is missing in {}; add it: {what}", place(table))
}

/// A value of the wrong type, out of the type's range, or not one of the allowed words.
pub fn wrong_value(name: &str, kind: &Kind, value: &DeValue<'_>) -> String {
    let leaf = name.rsplit('.').next().unwrap_or(name);
    let leaf = leaf.split('[').next().unwrap_or(leaf);
    let is = described(value);
    match (kind, value) {
        (Kind::Number | Kind::Whole { .. }, DeValue::String(text)) => match number_in(leaf, text) {
            Some(number) => {
                let number = if matches!(kind, Kind::Number) { trimmed(number) } else { format!("{number}") };
                format!("`{name}` is {is}, but takes {} without unit or quotes; write {number}", wanted(leaf, kind))
            }
            None => format!("`{name}` is {is}, but takes {}", wanted(leaf, kind)),
        },
        (Kind::Choice(words), DeValue::String(text)) => match nearest(text, words.iter().copied()) {
            Some(near) => format!("`{name}` is {is}; did you mean \"{near}\"?"),
            None => format!("`{name}` is {is}, but takes {}", wanted(leaf, kind)),
        },
        (Kind::Text, DeValue::Integer(i)) => {
            format!("`{name}` is {is}, but takes text; write it in quotes: \"{}\"", i.as_str())
        }
        (Kind::List, DeValue::String(text)) => {
            format!("`{name}` is {is}, but takes a list; write it in brackets: [\"{text}\"]")
        }
        (Kind::Tuple(len), DeValue::Array(items)) => {
            format!("`{name}` has {} values, but takes a list of exactly {len} values", items.len())
        }
        _ => format!("`{name}` is {is}, but takes {}", wanted(leaf, kind)),
    }
}

/// The nearest of `allowed` to `word`, where one is near enough to be meant.
pub fn nearest<'a>(word: &str, allowed: impl Iterator<Item = &'a str>) -> Option<&'a str> {
    let length = word.chars().count();
    let limit = if length <= 3 { 1 } else { (length / 3).max(2) };
    allowed.map(|a| (edits(word, a), a)).filter(|(d, _)| *d <= limit).min().map(|(_, a)| a)
}

/// Words in back quotes, with commas.
pub fn quoted(words: &[&str]) -> String {
    words.iter().map(|w| format!("`{w}`")).collect::<Vec<_>>().join(", ")
}

/// The unit a key's name states, as a word.
pub fn unit_of(key: &str) -> Option<&'static str> {
    UNITS.iter().filter(|(suffix, ..)| key.ends_with(suffix)).max_by_key(|(s, ..)| s.len()).map(|(_, word, _)| *word)
}

fn place(table: &str) -> String {
    if table.is_empty() { "the top of the file".into() } else { format!("[{table}]") }
}

fn wanted(key: &str, kind: &Kind) -> String {
    let unit = unit_of(key).map(|u| format!(" of {u}")).unwrap_or_default();
    match kind {
        Kind::Number => format!("a number{unit}"),
        Kind::Whole { max } if *max < u64::from(u32::MAX) => format!("a whole number{unit} from 0 to {max}"),
        Kind::Whole { .. } => format!("a whole number{unit}, not negative"),
        Kind::Text => "text in quotes".into(),
        Kind::Day => "a day in quotes, such as \"2026-01-31\"".into(),
        Kind::Flag => "true or false".into(),
        Kind::Choice(words) => {
            format!("one of {}", words.iter().map(|w| format!("\"{w}\"")).collect::<Vec<_>>().join(", "))
        }
        Kind::Table | Kind::Map => "a table".into(),
        Kind::List => "a list in brackets".into(),
        Kind::Tuple(len) => format!("a list of exactly {len} values"),
    }
}

fn described(value: &DeValue<'_>) -> String {
    match value {
        DeValue::String(s) => format!("the text \"{s}\""),
        DeValue::Integer(i) => i.as_str().to_owned(),
        DeValue::Float(f) => f.as_str().to_owned(),
        DeValue::Boolean(b) => b.to_string(),
        DeValue::Datetime(d) => format!("the date {d} without quotes"),
        DeValue::Array(_) => "a list".into(),
        DeValue::Table(_) => "a table".into(),
    }
}

/// A number at the beginning of a text, turned into the unit of the key where the text names one it knows.
fn number_in(key: &str, text: &str) -> Option<f64> {
    let text = text.trim();
    let end = text.find(|c: char| !(c.is_ascii_digit() || matches!(c, '.' | '-' | '+' | 'e'))).unwrap_or(text.len());
    let number: f64 = text[..end].parse().ok()?;
    let unit = text[end..].trim();
    if unit.is_empty() {
        return Some(number);
    }
    let (_, _, spellings) = UNITS.iter().filter(|(suffix, ..)| key.ends_with(suffix)).max_by_key(|(s, ..)| s.len())?;
    spellings.iter().find(|(s, _)| s.eq_ignore_ascii_case(unit)).map(|(_, factor)| number * factor)
}

/// The allowed key that `key` would be in its own unit, the word for that unit and the factor.
fn same_in_other_unit<'a>(allowed: &[&'a str], key: &str) -> Option<(&'a str, &'static str, f64)> {
    let (stem, spelling) = key.rsplit_once('_')?;
    UNITS.iter().find_map(|(suffix, word, spellings)| {
        let (_, factor) = spellings.iter().find(|(s, _)| *s == spelling)?;
        let to = allowed.iter().find(|a| a.strip_suffix(suffix) == Some(stem))?;
        Some((*to, *word, *factor))
    })
}

/// Allowed keys of the kind of unit that `key` ends with.
fn same_family<'a>(allowed: &[&'a str], key: &str) -> Option<(&'static str, Vec<&'a str>)> {
    let (_, spelling) = key.rsplit_once('_')?;
    let (suffix, word, _) = UNITS.iter().find(|(_, _, spellings)| spellings.iter().any(|(s, _)| *s == spelling))?;
    let family: Vec<&str> = allowed.iter().copied().filter(|a| a.ends_with(suffix)).collect();
    (!family.is_empty()).then_some((*word, family))
}

/// Tables in which `key` is known, at most three.
fn homes(schema: &Schema, key: &str) -> Vec<String> {
    schema
        .keys()
        .filter_map(|path| {
            let table = path.strip_suffix(key)?.strip_suffix('.')?;
            (!table.contains("[]")).then(|| format!("[{}]", table.replace('*', "NAME")))
        })
        .take(3)
        .collect()
}

fn trimmed(number: f64) -> String {
    // Twelve digits hide the binary tail of a product such as 500 x 0.001.
    let rounded: f64 = format!("{number:.12e}").parse().unwrap_or(number);
    format!("{rounded:?}")
}

/// Levenshtein distance in characters.
fn edits(a: &str, b: &str) -> usize {
    let b: Vec<char> = b.chars().collect();
    let mut row: Vec<usize> = (0..=b.len()).collect();
    for (i, ca) in a.chars().enumerate() {
        let mut corner = i;
        let mut left = i + 1;
        for (cell, cb) in row.iter_mut().skip(1).zip(&b) {
            let up = *cell;
            let best = (corner + usize::from(ca != *cb)).min(up + 1).min(left + 1);
            corner = up;
            left = best;
            *cell = best;
        }
        if let Some(first) = row.first_mut() {
            *first = i + 1;
        }
    }
    row.last().copied().unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distances_and_numbers() {
        assert_eq!(edits("kitten", "sitting"), 3);
        assert_eq!(edits("", "abc"), 3);
        assert_eq!(edits("abc", "abc"), 0);
        assert_eq!(nearest("longst_s", ["longest_s", "shortest_s"].into_iter()), Some("longest_s"));
        assert_eq!(nearest("zzz", ["longest_s"].into_iter()), None);
        assert_eq!(number_in("longest_s", "500 ms"), Some(0.5));
        assert_eq!(number_in("longest_s", "3 furlongs"), None);
        assert_eq!(trimmed(500.0 * 1e-3), "0.5");
    }

    #[test]
    fn units_are_read_from_key_names() {
        assert_eq!(unit_of("speed_deg_per_s"), Some("degrees per second"));
        assert_eq!(unit_of("settle_s"), Some("seconds"));
        assert_eq!(unit_of("places"), None);
    }
}
