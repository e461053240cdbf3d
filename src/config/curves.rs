//! Spectral data files as text: tables of values over wavelength, and the reflection factors of filter glasses.

use std::collections::BTreeMap;

/// Largest data file that is read, bytes.
pub const LARGEST_FILE: u64 = 32 << 20;

/// Values over wavelength, as in `wavelength_nm,r,g,b`.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Curves {
    /// Names of the value columns, in the order of the file.
    pub names: Vec<String>,
    /// Wavelengths in nm, strictly rising.
    pub wavelength_nm: Vec<f64>,
    /// One list of values a column, each as long as the wavelengths.
    pub columns: Vec<Vec<f64>>,
}

// === impl Curves ===

impl Curves {
    /// Reads `wavelength_nm,NAME,…` with comment lines that begin with `#`.
    ///
    /// # Errors
    /// One sentence with the line: header, a number that is none, wavelengths that do not rise, fewer than two rows.
    pub fn parse(text: &str) -> Result<Curves, String> {
        let mut lines = content(text);
        let (_, header) =
            lines.next().ok_or("it is empty; wanted is a header `wavelength_nm,NAME` and rows of numbers")?;
        let mut head = header.split(',').map(str::trim);
        if head.next() != Some("wavelength_nm") {
            return Err(format!("its header is `{header}`; the first column must be `wavelength_nm`"));
        }
        let names: Vec<String> = head.map(str::to_owned).collect();
        if names.is_empty() {
            return Err("it has no value column; the header must be `wavelength_nm,NAME`".into());
        }
        let mut curves = Curves { columns: vec![Vec::new(); names.len()], names, wavelength_nm: Vec::new() };
        for (line, row) in lines {
            curves.push(line, row)?;
        }
        if curves.wavelength_nm.len() < 2 {
            return Err("it has fewer than two rows; a curve needs at least two wavelengths".into());
        }
        Ok(curves)
    }

    fn push(&mut self, line: usize, row: &str) -> Result<(), String> {
        let values = numbers(line, row)?;
        if values.len() != self.names.len() + 1 {
            return Err(format!("line {line} has {} values, the header {}", values.len(), self.names.len() + 1));
        }
        let Some((&nm, rest)) = values.split_first() else { return Ok(()) };
        if self.wavelength_nm.last().is_some_and(|last| nm <= *last) {
            return Err(format!("line {line}: the wavelength {nm} does not rise above the line before; sort the rows"));
        }
        self.wavelength_nm.push(nm);
        for (column, value) in self.columns.iter_mut().zip(rest) {
            column.push(*value);
        }
        Ok(())
    }

    /// The values of a column by name.
    pub fn column(&self, name: &str) -> Option<&[f64]> {
        let at = self.names.iter().position(|n| n == name)?;
        self.columns.get(at).map(Vec::as_slice)
    }

    /// First and last wavelength, nm.
    pub fn range_nm(&self) -> (f64, f64) {
        let end = |v: Option<&f64>| v.copied().unwrap_or(f64::NAN);
        (end(self.wavelength_nm.first()), end(self.wavelength_nm.last()))
    }

    /// The smallest and largest value of all columns.
    pub fn value_range(&self) -> (f64, f64) {
        let all = self.columns.iter().flatten();
        all.fold((f64::INFINITY, f64::NEG_INFINITY), |(lo, hi), v| (lo.min(*v), hi.max(*v)))
    }
}

/// Reads the reflection factor P of each glass from a table with the columns `glass` and `reflection_factor_P`
/// (further columns are not read; a glass may have several rows with the same P; 0 = not known).
///
/// # Errors
/// One sentence with the line.
pub fn reflection_factors(text: &str) -> Result<BTreeMap<String, f64>, String> {
    let mut lines = content(text);
    let (_, header) = lines.next().ok_or("it is empty; wanted are the columns `glass` and `reflection_factor_P`")?;
    let at = |name: &str| {
        let place = header.split(',').position(|c| c.trim() == name);
        place.ok_or_else(|| format!("its header `{header}` has no column `{name}`"))
    };
    let (glass_at, factor_at) = (at("glass")?, at("reflection_factor_P")?);
    let mut factors = BTreeMap::new();
    for (line, row) in lines {
        let cells: Vec<&str> = row.split(',').map(str::trim).collect();
        let (Some(glass), Some(cell)) = (cells.get(glass_at), cells.get(factor_at)) else {
            return Err(format!("line {line} has fewer columns than the header"));
        };
        let factor: f64 = cell.parse().map_err(|_| format!("line {line}: `{cell}` is not a number"))?;
        if !(0.0..=1.0).contains(&factor) {
            return Err(format!("line {line}: the reflection factor {factor} is not between 0 and 1"));
        }
        factors.insert((*glass).to_owned(), factor);
    }
    Ok(factors)
}

/// Lines that say something, with their numbers from 1.
fn content(text: &str) -> impl Iterator<Item = (usize, &str)> {
    text.lines().enumerate().map(|(i, l)| (i + 1, l.trim())).filter(|(_, l)| !l.is_empty() && !l.starts_with('#'))
}

fn numbers(line: usize, row: &str) -> Result<Vec<f64>, String> {
    row.split(',')
        .map(|cell| match cell.trim().parse::<f64>() {
            Ok(v) if v.is_finite() => Ok(v),
            _ => Err(format!("line {line}: `{}` is not a number", cell.trim())),
        })
        .collect()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn tables_are_read_with_their_comments() {
        let c = Curves::parse("# kind: MODEL\nwavelength_nm,r,g\n300,0.1,0.2\n305,0.3,0.4\n").unwrap();
        assert_eq!(c.column("g"), Some(&[0.2, 0.4][..]));
        assert_eq!((c.range_nm(), c.value_range()), ((300.0, 305.0), (0.1, 0.4)));
        let p = reflection_factors("glass,reflection_factor_P,x\nBG3,0.91,\nBG3,0.91,7\nRG9,0.9,1\n").unwrap();
        assert_eq!(p.get("RG9"), Some(&0.9));
    }

    #[test]
    fn faults_name_the_line() {
        let fault = |text: &str| Curves::parse(text).unwrap_err();
        assert!(fault("wavelength_nm,v\n300,1\n300,2\n").contains("line 3"));
        assert!(fault("# c\nwavelength_nm,v\n300,one\n").contains("line 3: `one`"));
        assert!(fault("nm,v\n300,1\n").contains("wavelength_nm"));
        assert!(fault("wavelength_nm,v\n300,1,2\n").contains("3 values"));
        assert!(fault("").contains("empty") && fault("wavelength_nm,v\n1,1\n").contains("two"));
        assert!(fault("wavelength_nm,v\n300,NaN\n310,1\n").contains("line 2"));
        assert!(reflection_factors("glass,reflection_factor_P\nBG3,1.5\n").unwrap_err().contains("line 2"));
    }
}
