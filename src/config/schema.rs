//! The keys of a file format, read off the structs themselves: a deserialiser that is asked for values and remembers
//! every question. So the checks and the documentation cannot drift from the structs.

use super::source::join;
use serde::de::value::{Error, StrDeserializer};
use serde::de::{Deserialize, DeserializeSeed, Deserializer, IntoDeserializer, MapAccess, SeqAccess, Visitor};
use std::cell::RefCell;
use std::collections::BTreeMap;

/// What a key takes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Kind {
    /// A number, whole or not.
    Number,
    /// A whole number from 0 to `max`.
    Whole {
        /// Largest value of the type.
        max: u64,
    },
    /// Text in quotes.
    Text,
    /// A day, as text `2026-01-31`.
    Day,
    /// True or false.
    Flag,
    /// One of these words.
    Choice(&'static [&'static str]),
    /// A table with fixed keys.
    Table,
    /// A table whose keys are names (`*` in the schema).
    Map,
    /// A list (`[]` in the schema).
    List,
    /// A list of exactly so many.
    Tuple(usize),
}

/// One key of a format.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Key {
    /// What it takes.
    pub kind: Kind,
    /// The file is refused without it.
    pub required: bool,
}

/// All keys of a format by pattern: `camera.*.serial`, `filter_wheel.slot.*.glasses[].glass`; the file itself is "".
pub type Schema = BTreeMap<String, Key>;

/// What a probe is to do differently at one key.
#[derive(Clone, Copy)]
enum Trick<'a> {
    None,
    /// Leave the key out.
    Omit(&'a str),
    /// Give a text that is no date.
    PlainText(&'a str),
}

/// A deserialiser that invents values and logs what it was asked for.
struct Probe<'a> {
    path: String,
    log: &'a RefCell<BTreeMap<String, Kind>>,
    trick: Trick<'a>,
}

struct Fields<'a> {
    probe: Probe<'a>,
    names: std::vec::IntoIter<&'static str>,
    current: &'static str,
}

struct Items<'a> {
    probe: Probe<'a>,
    left: usize,
}

/// The keys that `T` reads.
pub fn of<T: for<'de> Deserialize<'de>>() -> Schema {
    let log = RefCell::new(BTreeMap::new());
    probe::<T>(&log, Trick::None);
    let found: Vec<(String, Kind)> = log.borrow().iter().map(|(k, v)| (k.clone(), v.clone())).collect();
    found
        .into_iter()
        .map(|(path, kind)| {
            let required = !probe::<T>(&log, Trick::Omit(&path));
            let day = kind == Kind::Text && !probe::<T>(&log, Trick::PlainText(&path));
            (path, Key { kind: if day { Kind::Day } else { kind }, required })
        })
        .collect()
}

/// True where `T` is content with what the probe gives.
fn probe<T: for<'de> Deserialize<'de>>(log: &RefCell<BTreeMap<String, Kind>>, trick: Trick<'_>) -> bool {
    T::deserialize(Probe { path: String::new(), log, trick }).is_ok()
}

/// Names of the keys directly under the table `pattern`.
pub fn children<'a>(schema: &'a Schema, pattern: &'a str) -> impl Iterator<Item = (&'a str, &'a Key)> {
    schema.iter().filter_map(move |(path, key)| {
        let name = match pattern {
            "" => path.as_str(),
            _ => path.strip_prefix(pattern)?.strip_prefix('.')?,
        };
        (!name.is_empty() && !name.contains(['.', '['])).then_some((name, key))
    })
}

// === impl Probe ===

impl<'a> Probe<'a> {
    fn note(&self, kind: Kind) {
        self.log.borrow_mut().entry(self.path.clone()).or_insert(kind);
    }

    fn below(&self, path: String) -> Probe<'a> {
        Probe { path, log: self.log, trick: self.trick }
    }

    fn text(&self) -> &'static str {
        self.note(Kind::Text);
        match self.trick {
            Trick::PlainText(path) if path == self.path => "plain",
            _ => "2026-01-31",
        }
    }
}

macro_rules! whole {
    ($($method:ident $max:expr;)*) => {$(
        fn $method<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Error> {
            self.note(Kind::Whole { max: $max });
            visitor.visit_u64(1)
        }
    )*};
}

macro_rules! text {
    ($($method:ident)*) => {$(
        fn $method<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Error> {
            visitor.visit_str(self.text())
        }
    )*};
}

impl<'de> Deserializer<'de> for Probe<'_> {
    type Error = Error;

    whole! {
        deserialize_u8 u64::from(u8::MAX);
        deserialize_u16 u64::from(u16::MAX);
        deserialize_u32 u64::from(u32::MAX);
        deserialize_u64 i64::MAX as u64;
    }

    text! { deserialize_str deserialize_string deserialize_identifier }

    fn deserialize_any<V: Visitor<'de>>(self, _: V) -> Result<V::Value, Error> {
        Err(serde::de::Error::custom("formats are made of plain structs only"))
    }

    fn deserialize_bool<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Error> {
        self.note(Kind::Flag);
        visitor.visit_bool(true)
    }

    fn deserialize_f64<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Error> {
        self.note(Kind::Number);
        visitor.visit_f64(1.0)
    }

    fn deserialize_option<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Error> {
        visitor.visit_some(self)
    }

    fn deserialize_newtype_struct<V: Visitor<'de>>(self, _: &'static str, visitor: V) -> Result<V::Value, Error> {
        visitor.visit_newtype_struct(self)
    }

    fn deserialize_seq<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Error> {
        self.note(Kind::List);
        visitor.visit_seq(Items { probe: self, left: 1 })
    }

    fn deserialize_tuple<V: Visitor<'de>>(self, len: usize, visitor: V) -> Result<V::Value, Error> {
        self.note(Kind::Tuple(len));
        visitor.visit_seq(Items { probe: self, left: len })
    }

    fn deserialize_map<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Error> {
        self.note(Kind::Map);
        visitor.visit_map(Fields { probe: self, names: vec!["*"].into_iter(), current: "*" })
    }

    fn deserialize_struct<V: Visitor<'de>>(
        self,
        _: &'static str,
        fields: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, Error> {
        self.note(Kind::Table);
        let names = fields
            .iter()
            .copied()
            .filter(|name| !matches!(self.trick, Trick::Omit(path) if path == join(&self.path, name)))
            .collect::<Vec<_>>();
        visitor.visit_map(Fields { probe: self, names: names.into_iter(), current: "" })
    }

    fn deserialize_enum<V: Visitor<'de>>(
        self,
        _: &'static str,
        variants: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, Error> {
        self.note(Kind::Choice(variants));
        let word: StrDeserializer<'_, Error> = variants.first().copied().unwrap_or("").into_deserializer();
        visitor.visit_enum(word)
    }

    serde::forward_to_deserialize_any! {
        i8 i16 i32 i64 i128 u128 f32 char bytes byte_buf unit unit_struct tuple_struct ignored_any
    }
}

// === impl Fields ===

impl<'de> MapAccess<'de> for Fields<'_> {
    type Error = Error;

    fn next_key_seed<K: DeserializeSeed<'de>>(&mut self, seed: K) -> Result<Option<K::Value>, Error> {
        let Some(name) = self.names.next() else { return Ok(None) };
        self.current = name;
        let word: StrDeserializer<'_, Error> = name.into_deserializer();
        seed.deserialize(word).map(Some)
    }

    fn next_value_seed<S: DeserializeSeed<'de>>(&mut self, seed: S) -> Result<S::Value, Error> {
        seed.deserialize(self.probe.below(join(&self.probe.path, self.current)))
    }
}

// === impl Items ===

impl<'de> SeqAccess<'de> for Items<'_> {
    type Error = Error;

    fn next_element_seed<S: DeserializeSeed<'de>>(&mut self, seed: S) -> Result<Option<S::Value>, Error> {
        if self.left == 0 {
            return Ok(None);
        }
        self.left -= 1;
        seed.deserialize(self.probe.below(format!("{}[]", self.probe.path))).map(Some)
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::config::{calibration::CameraCalibration, instrument::Instrument, scan::Scan};

    #[test]
    fn the_schema_of_a_scan_is_its_structs() {
        let s = of::<Scan>();
        assert_eq!(s["exposure.longest_s"], Key { kind: Kind::Number, required: true });
        assert_eq!(s["incidence.directions[]"].kind, Kind::Tuple(2));
        assert!(!s["incidence.directions"].required && !s["dark"].required && !s["dark.frames"].required);
        assert_eq!(s["dark.frames"].kind, Kind::Whole { max: u64::from(u32::MAX) });
        assert!(matches!(s["incidence.sides[]"].kind, Kind::Choice(c) if c.contains(&"reflection-back")));
        let under: Vec<&str> = children(&s, "exposure").map(|(n, _)| n).collect();
        assert_eq!(under, ["longest_s", "policy", "ratio", "shortest_s"]);
    }

    #[test]
    fn maps_days_and_nested_tables_are_seen() {
        let i = of::<Instrument>();
        assert!(i["camera.*.serial"].required && !i["holder.changer"].required);
        assert!(i["holder.changer.axis.serial"].required, "required once the changer is there");
        assert_eq!(i["filter_wheel.slot.*.glasses[].thickness_mm"].kind, Kind::Number);
        let c = of::<CameraCalibration>();
        assert_eq!(c["valid_until"].kind, Kind::Day);
        assert_eq!(c["camera_serial"].kind, Kind::Text);
    }
}
