//! Curves on the bench's grid: 300-1700 nm in 5 nm steps, read from CSV, and transmittances of glass stacks.

use super::error::{Result, SimError, beside};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Points of the grid.
pub const POINTS: usize = 281;
/// Step of the grid.
pub const STEP_NM: f64 = 5.0;
/// First wavelength of the grid.
pub const FIRST_NM: f64 = 300.0;

/// Values on the grid.
#[derive(Debug, Clone, PartialEq)]
pub struct Curve(pub Vec<f64>);

/// A spectrum as the files name it: a constant, or a column of a CSV times a scale.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SpectrumFile {
    /// The same value at all wavelengths; excludes `csv`.
    pub constant: Option<f64>,
    /// CSV with a header row, first column `wavelength_nm`; relative to the file that names it.
    pub csv: Option<PathBuf>,
    /// Column name; the first value column without it.
    pub column: Option<String>,
    /// Factor on the column, 1 without it.
    pub scale: Option<f64>,
}

/// What a table says outside its range.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Outside {
    /// Zero (detectors).
    Zero,
    /// The table must cover the grid (lamp, glasses, mirrors, samples).
    Refuse,
}

/// One table: wavelengths and named columns.
#[derive(Debug, Clone)]
pub struct Table {
    path: PathBuf,
    names: Vec<String>,
    wavelengths: Vec<f64>,
    columns: Vec<Vec<f64>>,
}

/// Wavelength of grid point `i` in nm.
pub fn wavelength_nm(i: usize) -> f64 {
    FIRST_NM + STEP_NM * i as f64
}

// === impl Curve ===

impl Curve {
    /// The same value everywhere.
    pub fn constant(value: f64) -> Curve {
        Curve(vec![value; POINTS])
    }

    /// Product point by point.
    pub fn times(&self, other: &Curve) -> Curve {
        Curve(self.0.iter().zip(&other.0).map(|(a, b)| a * b).collect())
    }

    /// All values times `factor`.
    pub fn scaled(&self, factor: f64) -> Curve {
        Curve(self.0.iter().map(|a| a * factor).collect())
    }

    /// Integral over the grid by the trapezoidal rule, value times nm.
    pub fn integral(&self) -> f64 {
        let inner: f64 = self.0.iter().sum();
        let ends = self.0.first().copied().unwrap_or(0.0) + self.0.last().copied().unwrap_or(0.0);
        STEP_NM * (inner - 0.5 * ends)
    }

    /// Value at any wavelength by straight lines; zero outside the grid.
    pub fn at(&self, nm: f64) -> f64 {
        let t = (nm - FIRST_NM) / STEP_NM;
        if !(0.0..=(POINTS - 1) as f64).contains(&t) {
            return 0.0;
        }
        let i = (t as usize).min(POINTS - 2);
        let f = t - i as f64;
        self.0[i] * (1.0 - f) + self.0[i + 1] * f
    }
}

// === impl Table ===

impl Table {
    /// Reads a CSV with `#` comments, one header row, wavelengths rising in the first column.
    pub fn read(path: &Path) -> Result<Table> {
        let bad = |message: String| SimError::format(path, message);
        let file = std::fs::File::open(path).map_err(|source| SimError::Read { path: path.to_owned(), source })?;
        let mut reader = csv::ReaderBuilder::new().comment(Some(b'#')).trim(csv::Trim::All).from_reader(file);
        let header = reader.headers().map_err(|e| bad(format!("no header row: {e}")))?.clone();
        if header.get(0) != Some("wavelength_nm") || header.len() < 2 {
            return Err(bad("the header must be `wavelength_nm` and at least one value column".to_owned()));
        }
        let names: Vec<String> = header.iter().skip(1).map(str::to_owned).collect();
        let (mut wavelengths, mut columns) = (Vec::new(), vec![Vec::new(); names.len()]);
        for record in reader.records() {
            let record = record.map_err(|e| bad(format!("not a table: {e}")))?;
            let line = record.position().map_or(0, csv::Position::line);
            let mut numbers = record.iter().map(|field| {
                let number = field.parse::<f64>().ok().filter(|v| v.is_finite());
                number.ok_or_else(|| bad(format!("line {line}: `{field}` is not a number")))
            });
            wavelengths.extend(numbers.next().transpose()?);
            for (column, number) in columns.iter_mut().zip(numbers) {
                column.push(number?);
            }
        }
        if wavelengths.len() < 2 || wavelengths.windows(2).any(|w| w[1] <= w[0]) {
            return Err(bad("needs at least two rows with rising wavelengths".to_owned()));
        }
        Ok(Table { path: path.to_owned(), names, wavelengths, columns })
    }

    /// A column on the grid by straight lines; the first value column without a name.
    pub fn curve(&self, column: Option<&str>, outside: Outside) -> Result<Curve> {
        let place = match column {
            None => Some(0),
            Some(name) => self.names.iter().position(|n| n == name),
        };
        let Some(values) = place.and_then(|p| self.columns.get(p)) else {
            let known = self.names.iter().take(12).cloned().collect::<Vec<_>>().join(", ");
            let name = column.unwrap_or("value");
            return Err(SimError::format(&self.path, format!("no column `{name}`; it has {known}")));
        };
        let (first, last) = (self.wavelengths[0], self.wavelengths[self.wavelengths.len() - 1]);
        if outside == Outside::Refuse && (first > FIRST_NM || last < wavelength_nm(POINTS - 1)) {
            let message = format!("covers {first}-{last} nm; 300-1700 nm are needed");
            return Err(SimError::format(&self.path, message));
        }
        Ok(Curve((0..POINTS).map(|i| self.interpolate(values, wavelength_nm(i))).collect()))
    }

    fn interpolate(&self, values: &[f64], nm: f64) -> f64 {
        let w = &self.wavelengths;
        if nm < w[0] || nm > w[w.len() - 1] {
            return 0.0;
        }
        let hi = w.partition_point(|&x| x < nm).clamp(1, w.len() - 1);
        let f = (nm - w[hi - 1]) / (w[hi] - w[hi - 1]);
        values[hi - 1] * (1.0 - f) + values[hi] * f
    }
}

// === impl SpectrumFile ===

impl SpectrumFile {
    /// The curve on the grid; `file` is the file that names it (for relative paths and messages).
    pub fn load(&self, file: &Path, outside: Outside) -> Result<Curve> {
        let scale = self.scale.unwrap_or(1.0);
        let curve = match (self.constant, &self.csv) {
            (Some(value), None) => Curve::constant(value).scaled(scale),
            (None, Some(csv)) => Table::read(&beside(file, csv))?.curve(self.column.as_deref(), outside)?.scaled(scale),
            _ => return Err(SimError::format(file, "a spectrum needs either `constant` or `csv`")),
        };
        if curve.0.iter().any(|v| *v < 0.0) {
            return Err(SimError::format(file, format!("the spectrum {self:?} has negative values")));
        }
        Ok(curve)
    }
}

/// Transmittance of a stack of glasses: product over the stack of P * tau(1 mm)^d, d in mm (header of the glass file).
pub fn stack(glasses: &Table, parameters: &Path, stack: &[(String, f64)]) -> Result<Curve> {
    let mut total = Curve::constant(1.0);
    for (glass, thickness_mm) in stack {
        let factor = reflection_factor(parameters, glass)?;
        let tau = glasses.curve(Some(glass), Outside::Refuse)?;
        let one = Curve(tau.0.iter().map(|t| factor * t.powf(*thickness_mm)).collect());
        total = total.times(&one);
    }
    Ok(total)
}

/// Reflection factor P of a glass from the parameter file.
fn reflection_factor(path: &Path, glass: &str) -> Result<f64> {
    let file = std::fs::File::open(path).map_err(|source| SimError::Read { path: path.to_owned(), source })?;
    let mut reader = csv::ReaderBuilder::new().comment(Some(b'#')).flexible(true).from_reader(file);
    let header = reader.headers().map_err(|e| SimError::format(path, format!("no header row: {e}")))?;
    let column = header.iter().position(|h| h == "reflection_factor_P");
    for record in reader.records() {
        let record = record.map_err(|e| SimError::format(path, format!("not a table: {e}")))?;
        if record.get(0) == Some(glass) {
            let value = column.and_then(|c| record.get(c)).and_then(|v| v.parse::<f64>().ok());
            return value.ok_or_else(|| SimError::format(path, format!("glass {glass} has no reflection_factor_P")));
        }
    }
    Err(SimError::format(path, format!("no glass `{glass}`; use a catalogue name of that file")))
}
