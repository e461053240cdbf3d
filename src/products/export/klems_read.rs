//! Reads a Klems matrix XML back, for round trips and for comparing with files of others.
//!
//! The file's own theta bounds and numbers of azimuths are trusted, not the name of its basis: two tables are in use
//! under the name "Klems Half".

use super::ExportError;
use crate::engine::optics::basis::{AngleBasis, Ring};
use crate::engine::optics::side::Side;
use crate::products::context::side_words;
use roxmltree::{Document, Node};

/// Patches of a basis at most: Klems Full has 145.
const MOST_PATCHES: usize = 4096;

/// What a Klems file says.
#[derive(Debug, Clone, PartialEq)]
pub struct KlemsFile {
    /// `Material/Name`.
    pub name: String,
    /// `Material/Manufacturer`.
    pub manufacturer: String,
    /// `Material/Comments`.
    pub comments: Option<String>,
    /// The angle basis of rows and columns.
    pub basis: AngleBasis,
    /// All matrices, in file order.
    pub blocks: Vec<KlemsBlock>,
}

/// One matrix of the file.
#[derive(Debug, Clone, PartialEq)]
pub struct KlemsBlock {
    /// `Wavelength` as written, e.g. `Visible`.
    pub wavelength: String,
    /// Direction.
    pub side: Side,
    /// BSDF in 1/sr, `values[outgoing * n + incident]`.
    pub values: Vec<f64>,
}

/// Reads the text of a file.
///
/// # Errors
/// [`ExportError::Malformed`] with the element that is missing or wrong.
pub fn read_klems(text: &str) -> Result<KlemsFile, ExportError> {
    let document = Document::parse(text).map_err(|e| malformed(format!("not XML: {e}")))?;
    let root = document.root_element();
    let structure = text_of(root, "IncidentDataStructure")?;
    if structure != "Columns" {
        return Err(malformed(format!("IncidentDataStructure is '{structure}'; only Columns can be read")));
    }
    let material = find(root, "Material")?;
    let basis = read_basis(find(find(root, "DataDefinition")?, "AngleBasis")?)?;
    let mut blocks = Vec::new();
    for data in root.descendants().filter(|n| n.has_tag_name_any("WavelengthData")) {
        let wavelength = text_of(data, "Wavelength")?;
        for block in data.descendants().filter(|n| n.has_tag_name_any("WavelengthDataBlock")) {
            blocks.push(read_block(block, &wavelength, basis.len())?);
        }
    }
    Ok(KlemsFile {
        name: text_of(material, "Name")?,
        manufacturer: text_of(material, "Manufacturer").unwrap_or_default(),
        comments: text_of(material, "Comments").ok(),
        basis,
        blocks,
    })
}

fn read_basis(node: Node) -> Result<AngleBasis, ExportError> {
    let name = text_of(node, "AngleBasisName")?;
    let rings = node
        .descendants()
        .filter(|n| n.has_tag_name_any("AngleBasisBlock"))
        .map(|b| {
            Ok(Ring {
                lower_deg: number_of(b, "LowerTheta")?,
                upper_deg: number_of(b, "UpperTheta")?,
                patches: patches_of(b)?,
            })
        })
        .collect::<Result<Vec<_>, ExportError>>()?;
    let total: usize = rings.iter().map(|r| r.patches).sum();
    if total > MOST_PATCHES {
        return Err(malformed(format!("angle basis '{name}' has {total} patches, at most {MOST_PATCHES} can be read")));
    }
    if rings.is_empty() || rings.iter().any(|r| r.patches == 0 || r.upper_deg <= r.lower_deg) {
        return Err(malformed(format!("angle basis '{name}' has no rings, or a ring without patches or width")));
    }
    Ok(AngleBasis { name, rings })
}

fn read_block(node: Node, wavelength: &str, patches: usize) -> Result<KlemsBlock, ExportError> {
    let direction = text_of(node, "WavelengthDataDirection")?;
    let Some(side) = Side::ALL.into_iter().find(|&s| side_words(s) == direction) else {
        return Err(malformed(format!("WavelengthDataDirection is '{direction}'")));
    };
    let data = text_of(node, "ScatteringData")?;
    let values = data
        .split([' ', '\t', '\r', '\n', ','])
        .filter(|w| !w.is_empty())
        .map(|w| match w.parse::<f64>() {
            Ok(v) if v.is_finite() => Ok(v),
            _ => Err(malformed(format!("{wavelength} {direction}: '{w}' is not a finite number"))),
        })
        .collect::<Result<Vec<_>, _>>()?;
    if values.len() != patches * patches {
        return Err(malformed(format!(
            "{wavelength} {direction} has {} values, {patches} x {patches} are needed",
            values.len()
        )));
    }
    Ok(KlemsBlock { wavelength: wavelength.to_owned(), side, values })
}

fn find<'a, 'i>(node: Node<'a, 'i>, tag: &str) -> Result<Node<'a, 'i>, ExportError> {
    node.descendants().find(|n| n.has_tag_name_any(tag)).ok_or_else(|| malformed(format!("no element {tag}")))
}

fn text_of(node: Node, tag: &str) -> Result<String, ExportError> {
    let text = find(node, tag)?.text().unwrap_or("").trim();
    if text.is_empty() { Err(malformed(format!("element {tag} is empty"))) } else { Ok(text.to_owned()) }
}

fn number_of(node: Node, tag: &str) -> Result<f64, ExportError> {
    let text = text_of(node, tag)?;
    let number = text.parse().ok().filter(|n: &f64| n.is_finite());
    number.ok_or_else(|| malformed(format!("{tag} is '{text}', a number is needed")))
}

fn patches_of(node: Node) -> Result<usize, ExportError> {
    let n = number_of(node, "nPhis")?;
    let whole = n.fract() == 0.0 && (1.0..=MOST_PATCHES as f64).contains(&n);
    if whole { Ok(n as usize) } else { Err(malformed(format!("nPhis is {n}, 1 to {MOST_PATCHES} are possible"))) }
}

fn malformed(what: String) -> ExportError {
    ExportError::Malformed(what)
}

/// Element by local name: files with and without the namespace are in use.
trait LocalName {
    fn has_tag_name_any(&self, name: &str) -> bool;
}

// === impl KlemsFile ===

impl KlemsFile {
    /// The matrix of one wavelength word and direction.
    pub fn block(&self, wavelength: &str, side: Side) -> Option<&KlemsBlock> {
        self.blocks.iter().find(|b| b.wavelength == wavelength && b.side == side)
    }

    /// Direct-hemispherical values of all incident patches of a matrix: sum over o of L_o B\[o\]\[i\].
    pub fn hemispherical(&self, wavelength: &str, side: Side) -> Option<Vec<f64>> {
        let block = self.block(wavelength, side)?;
        let mut sums = vec![0.0; self.basis.len()];
        for (row, l) in block.values.chunks_exact(self.basis.len()).zip(self.basis.projected_solid_angles()) {
            for (sum, value) in sums.iter_mut().zip(row) {
                *sum += l * value;
            }
        }
        Some(sums)
    }
}

// === impl LocalName ===

impl LocalName for Node<'_, '_> {
    fn has_tag_name_any(&self, name: &str) -> bool {
        self.is_element() && self.tag_name().name() == name
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    const PRISM: &str = include_str!("../../../config/sim/samples/prism42_raytraced_klems.xml");

    /// T .954/.948/.464 at incidence 0 / 30 / 60, as Radiance's own library gives for this file.
    #[test]
    fn the_prism_film_of_another_writer_is_read() {
        let file = read_klems(PRISM).unwrap();
        let t = file.hemispherical("Visible", Side::TransmissionFront).unwrap();
        for (patch, quoted) in [(0, 0.954), (25, 0.948), (93, 0.464)] {
            assert!((t[patch] - quoted).abs() < 6e-4, "patch {patch}: {} instead of {quoted}", t[patch]);
        }
        let r = file.hemispherical("Visible", Side::ReflectionFront).unwrap();
        assert!((r[0] - 0.046).abs() < 6e-4);
    }

    #[test]
    fn bad_files_are_told_what_is_bad() {
        let cases = [
            (PRISM.replacen("Columns", "Rows", 1), "IncidentDataStructure is 'Rows'"),
            (PRISM.replacen("<nPhis>8</nPhis>", "<nPhis>7</nPhis>", 1), "144 x 144 are needed"),
            (PRISM.replacen("<Name>synthetic saw-tooth prism film n=1.49</Name>", "<Name/>", 1), "Name is empty"),
            (PRISM.replacen("Transmission Front", "Sideways", 1), "'Sideways'"),
            ("<WindowElement>".to_owned(), "not XML"),
        ];
        for (text, part) in cases {
            let error = read_klems(&text).unwrap_err().to_string();
            assert!(error.contains(part), "'{part}' is not in '{error}'");
        }
    }
}
