//! Samples: sums of components, each a spectrum times an angular law on some of the four sides.

use super::block::ScatterTable;
use super::error::{Result, SimError, beside, read_text};
use super::law::Law;
use super::spectrum::{Curve, Outside, SpectrumFile, wavelength_nm};
use super::vector::Side;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// A sample file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SampleFile {
    /// Name for logs.
    pub name: String,
    /// The components.
    pub component: Vec<ComponentFile>,
}

/// One component.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ComponentFile {
    /// Sides it works on: tf, rf, tb, rb.
    pub sides: Vec<Side>,
    /// Its spectrum; direct-hemispherical value, or factor on a file's values.
    pub spectrum: SpectrumFile,
    /// Its angular law.
    pub law: LawFile,
}

/// An angular law.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "kebab-case", deny_unknown_fields)]
pub enum LawFile {
    /// Equal radiance everywhere.
    Lambertian {},
    /// Straight through or mirrored.
    Specular {
        /// Refractive index of the slab whose angle dependence it follows; absent = none.
        index: Option<f64>,
    },
    /// Gaussian in direction cosines.
    Rough {
        /// Standard deviation, 0.02 to 1.
        width: f64,
    },
    /// Klems matrix or tensor tree XML beside the sample file.
    Xml {
        /// The file.
        file: PathBuf,
    },
}

/// A component ready for use.
#[derive(Debug, Clone)]
pub struct Component {
    /// Sides it works on.
    pub sides: Vec<Side>,
    /// Spectrum on the grid.
    pub spectrum: Curve,
    /// Angular law.
    pub law: Law,
}

/// A sample (or a diffuser) ready for use.
#[derive(Debug, Clone)]
pub struct Sample {
    /// Name.
    pub name: String,
    /// Components.
    pub components: Vec<Component>,
}

// === impl Sample ===

impl Sample {
    /// Reads a sample file and refuses one that gives back more light than it gets.
    pub fn read(path: &Path) -> Result<Sample> {
        let text = read_text(path)?;
        let file: SampleFile = toml::from_str(&text).map_err(|e| SimError::format(path, e.to_string()))?;
        let components = file.component.iter().map(|c| c.load(path)).collect::<Result<Vec<_>>>()?;
        if components.is_empty() {
            return Err(SimError::format(path, "a sample needs at least one [[component]]"));
        }
        let sample = Sample { name: file.name, components };
        sample.check_energy(path)?;
        Ok(sample)
    }

    /// A Lambertian diffuser on `sides` with hemispherical value `spectrum`.
    pub fn diffuser(name: &str, sides: &[Side], spectrum: Curve) -> Sample {
        let component = Component { sides: sides.to_vec(), spectrum, law: Law::Lambertian };
        Sample { name: name.to_owned(), components: vec![component] }
    }

    /// Direct-hemispherical value on `side` at incidence `theta_deg`, `phi_deg` (azimuth of the source) on the grid.
    pub fn hemispherical(&self, side: Side, theta_deg: f64, phi_deg: f64) -> Curve {
        let s = side.source_vector(theta_deg, phi_deg);
        let mut sum = Curve::constant(0.0);
        for component in self.components.iter().filter(|c| c.sides.contains(&side)) {
            if let Some(emission) = component.law.emission(side, s, 0.004) {
                let value = emission.hemispherical();
                sum.0.iter_mut().zip(&component.spectrum.0).for_each(|(a, b)| *a += value * b);
            }
        }
        sum
    }

    fn check_energy(&self, path: &Path) -> Result<()> {
        for (t, r) in [(Side::TransmissionFront, Side::ReflectionFront), (Side::TransmissionBack, Side::ReflectionBack)]
        {
            for theta in [0.0, 60.0] {
                let (ht, hr) = (self.hemispherical(t, theta, 0.0), self.hemispherical(r, theta, 0.0));
                let worst = ht.0.iter().zip(&hr.0).map(|(a, b)| a + b).enumerate().max_by(|a, b| a.1.total_cmp(&b.1));
                if let Some((i, total)) = worst
                    && total > 1.005
                {
                    let at = wavelength_nm(i);
                    let message = format!("T + R = {total:.3} at {at} nm, {theta} degrees ({t:?}); 1 is the most");
                    return Err(SimError::format(path, message));
                }
            }
        }
        Ok(())
    }
}

// === impl ComponentFile ===

impl ComponentFile {
    fn load(&self, path: &Path) -> Result<Component> {
        let law = match &self.law {
            LawFile::Lambertian {} => Law::Lambertian,
            LawFile::Specular { index } => {
                if index.is_some_and(|n| !(1.05..=4.0).contains(&n)) {
                    return Err(SimError::format(path, "law.index is out of range; 1.05 to 4 is allowed"));
                }
                Law::Specular { index: *index }
            }
            LawFile::Rough { width } => {
                if !(0.02..=1.0).contains(width) {
                    return Err(SimError::format(path, format!("law.width = {width}; 0.02 to 1 is allowed")));
                }
                Law::Rough { width: *width }
            }
            LawFile::Xml { file } => Law::Table(Arc::new(ScatterTable::read(&beside(path, file))?)),
        };
        Ok(Component { sides: self.sides.clone(), spectrum: self.spectrum.load(path, Outside::Refuse)?, law })
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used)]
    use super::*;

    fn read(text: &str) -> String {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("s.toml");
        std::fs::write(&path, text).unwrap();
        Sample::read(&path).map_or_else(|e| e.to_string(), |s| s.name)
    }

    #[test]
    fn a_sample_that_makes_light_or_has_unknown_words_is_refused() {
        let lambertian = |sides: &str, value: f64, more: &str| {
            format!("[[component]]\nsides = {sides}\nspectrum = {{ constant = {value} }}\nlaw = {more}\n")
        };
        let plain = "{ kind = \"lambertian\" }";
        let good = format!("name = \"g\"\n{}", lambertian("[\"tf\"]", 0.7, plain));
        assert_eq!(read(&good), "g");
        let much = format!("{good}{}", lambertian("[\"rf\"]", 0.6, plain));
        assert!(read(&much).contains("T + R = 1.300"), "{}", read(&much));
        assert!(read(&good.replace("tf", "xx")).contains("unknown variant `xx`"));
        assert!(read(&good.replace("constant", "konstant")).contains("konstant"));
        let narrow = good.replace(plain, "{ kind = \"rough\", width = 0.001 }");
        assert!(read(&narrow).contains("0.02 to 1 is allowed"), "{}", read(&narrow));
        assert!(read("name = \"e\"\ncomponent = []").contains("at least one"));
    }
}
