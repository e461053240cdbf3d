//! Scattering data of a BSDF XML file: one block a hemisphere pair, missing ones by reciprocity.
//!
//! The file names an incident patch by the in-plane direction in which light travels, so with p_in = -(s_x, s_y)
//! and p_out = (u_x, u_y) a block is a function B(p_in, p_out), and reciprocity reads
//! B_reversed(p_in, p_out) = B(-p_out, -p_in).

use super::error::{Result, SimError, read_text};
use super::klems::{Basis, Matrix};
use super::tree::{Tree, square_to_disc};
use super::vector::Side;
use std::collections::BTreeMap;
use std::f64::consts::PI;
use std::path::Path;
use std::sync::Arc;

/// One block's values.
#[derive(Debug, Clone)]
pub enum Block {
    /// Klems matrix.
    Matrix(Matrix),
    /// Tensor tree.
    Tree(Tree),
}

/// All blocks of one file (visible band).
#[derive(Debug, Clone, Default)]
pub struct ScatterTable {
    blocks: BTreeMap<Side, Arc<Block>>,
}

/// A block under one incident direction.
#[derive(Debug, Clone)]
pub enum Lookup {
    /// One value a patch of `basis`; the patch is looked up at `sign` times the outgoing direction.
    Column {
        /// Patches.
        basis: Basis,
        /// Values in 1/sr.
        values: Vec<f64>,
        /// +1, or -1 where the block is read backwards.
        sign: f64,
    },
    /// A tree.
    Tree {
        /// The block.
        block: Arc<Block>,
        /// Travel direction in the plane.
        p_in: [f64; 2],
        /// Read backwards.
        backwards: bool,
    },
}

/// Cells along the square that a tree's hemispherical value is summed over.
const SQUARE: usize = 256;

// === impl ScatterTable ===

impl ScatterTable {
    /// Reads a Klems matrix or tensor tree XML.
    pub fn read(path: &Path) -> Result<ScatterTable> {
        let text = read_text(path)?;
        let options = roxmltree::ParsingOptions { allow_dtd: false, ..Default::default() };
        let document = roxmltree::Document::parse_with_options(&text, options)
            .map_err(|e| SimError::format(path, format!("not XML: {e}")))?;
        let root = document.root_element();
        let structure = text_of(root, "IncidentDataStructure").unwrap_or_default();
        let rank = match structure.as_str() {
            "Columns" => None,
            "TensorTree3" => Some(3),
            "TensorTree4" => Some(4),
            other => {
                let message = format!("IncidentDataStructure `{other}`; Columns, TensorTree3 and TensorTree4 are read");
                return Err(SimError::format(path, message));
            }
        };
        let bad = |message: String| SimError::format(path, message);
        let bases = bases(root).map_err(bad)?;
        let mut table = ScatterTable::default();
        for data in root.descendants().filter(|n| n.has_tag_name_local("WavelengthData")) {
            if text_of(data, "Wavelength").is_some_and(|w| w != "Visible") {
                continue;
            }
            for block in data.descendants().filter(|n| n.has_tag_name_local("WavelengthDataBlock")) {
                let (side, block) = read_block(block, rank, &bases).map_err(bad)?;
                table.blocks.entry(side).or_insert_with(|| Arc::new(block));
            }
        }
        if table.blocks.is_empty() {
            return Err(bad("has no block for the visible band".to_owned()));
        }
        Ok(table)
    }

    /// Sides the file or reciprocity gives.
    pub fn sides(&self) -> Vec<Side> {
        let known = |side: &Side| self.blocks.contains_key(side) || self.blocks.contains_key(&side.reversed());
        Side::ALL.into_iter().filter(known).collect()
    }

    /// The block of `side` for light travelling along `p_in` in the plane.
    pub fn lookup(&self, side: Side, p_in: [f64; 2]) -> Option<Lookup> {
        let forwards = self.blocks.get(&side);
        let backwards = forwards.is_none();
        let block = forwards.or_else(|| self.blocks.get(&side.reversed()))?;
        Some(match block.as_ref() {
            Block::Matrix(m) if backwards => {
                Lookup::Column { basis: m.columns.clone(), values: m.row([-p_in[0], -p_in[1]]), sign: -1.0 }
            }
            Block::Matrix(m) => Lookup::Column { basis: m.rows.clone(), values: m.column(p_in), sign: 1.0 },
            Block::Tree(_) => Lookup::Tree { block: Arc::clone(block), p_in, backwards },
        })
    }
}

// === impl Lookup ===

impl Lookup {
    /// BSDF at outgoing (x, y), 1/sr.
    pub fn at(&self, p_out: [f64; 2]) -> f64 {
        match self {
            Lookup::Column { basis, values, sign } => {
                values.get(basis.index([sign * p_out[0], sign * p_out[1]])).copied().unwrap_or(0.0).max(0.0)
            }
            Lookup::Tree { block, p_in, backwards } => match block.as_ref() {
                Block::Tree(tree) if *backwards => tree.value([-p_out[0], -p_out[1]], [-p_in[0], -p_in[1]]),
                Block::Tree(tree) => tree.value(*p_in, p_out),
                Block::Matrix(_) => 0.0,
            },
        }
    }

    /// Direct-hemispherical value: sum of projected solid angle times value.
    pub fn hemispherical(&self) -> f64 {
        match self {
            Lookup::Column { basis, values, .. } => {
                values.iter().enumerate().map(|(i, v)| basis.projected(i) * v.max(0.0)).sum()
            }
            Lookup::Tree { .. } => {
                let cell = |i: usize| (i as f64 + 0.5) / SQUARE as f64;
                let sum: f64 =
                    (0..SQUARE * SQUARE).map(|i| self.at(square_to_disc([cell(i / SQUARE), cell(i % SQUARE)]))).sum();
                PI * sum / (SQUARE * SQUARE) as f64
            }
        }
    }
}

/// Element names without their namespace.
trait LocalName {
    fn has_tag_name_local(&self, name: &str) -> bool;
}

impl LocalName for roxmltree::Node<'_, '_> {
    fn has_tag_name_local(&self, name: &str) -> bool {
        self.is_element() && self.tag_name().name() == name
    }
}

/// Trimmed text of the first descendant element `name`.
fn text_of(node: roxmltree::Node<'_, '_>, name: &str) -> Option<String> {
    let found = node.descendants().find(|n| n.has_tag_name_local(name))?;
    found.text().map(|t| t.trim().to_owned())
}

/// All bases by name, from the file's own bounds.
fn bases(root: roxmltree::Node<'_, '_>) -> std::result::Result<BTreeMap<String, Basis>, String> {
    let mut found = BTreeMap::new();
    for basis in root.descendants().filter(|n| n.has_tag_name_local("AngleBasis")) {
        let Some(name) = text_of(basis, "AngleBasisName") else { continue };
        let mut rings = Vec::new();
        for ring in basis.descendants().filter(|n| n.has_tag_name_local("AngleBasisBlock")) {
            let number = |tag: &str| text_of(ring, tag).and_then(|t| t.parse::<f64>().ok());
            match (number("LowerTheta"), number("UpperTheta"), number("nPhis")) {
                (Some(lower), Some(upper), Some(n)) => rings.push((lower, upper, n as usize)),
                _ => return Err(format!("basis {name}: a ring needs LowerTheta, UpperTheta and nPhis")),
            }
        }
        let made = Basis::new(&rings).map_err(|e| format!("basis {name}: {e}"))?;
        found.insert(name, made);
    }
    Ok(found)
}

/// One WavelengthDataBlock.
fn read_block(
    node: roxmltree::Node<'_, '_>,
    rank: Option<usize>,
    bases: &BTreeMap<String, Basis>,
) -> std::result::Result<(Side, Block), String> {
    let direction = text_of(node, "WavelengthDataDirection").unwrap_or_default();
    let side = match direction.as_str() {
        "Transmission Front" => Side::TransmissionFront,
        "Transmission Back" => Side::TransmissionBack,
        "Reflection Front" => Side::ReflectionFront,
        "Reflection Back" => Side::ReflectionBack,
        other => return Err(format!("WavelengthDataDirection `{other}` is none of the four")),
    };
    let text = text_of(node, "ScatteringData").unwrap_or_default();
    if let Some(rank) = rank {
        return Ok((side, Block::Tree(Tree::parse(rank, &text).map_err(|e| format!("{direction}: {e}"))?)));
    }
    let basis = |tag: &str| {
        let name = text_of(node, tag).unwrap_or_default();
        bases.get(&name).cloned().ok_or_else(|| format!("{direction}: {tag} `{name}` is not defined in the file"))
    };
    let (rows, columns) = (basis("RowAngleBasis")?, basis("ColumnAngleBasis")?);
    let mut values = Vec::with_capacity(rows.len() * columns.len());
    for token in text.split(|c: char| c.is_whitespace() || c == ',').filter(|t| !t.is_empty()) {
        let value = token.parse::<f64>().ok().filter(|v| v.is_finite());
        values.push(value.ok_or_else(|| format!("{direction}: `{token}` is not a number"))?);
    }
    if values.len() != rows.len() * columns.len() {
        return Err(format!("{direction}: {} numbers, {} x {} are needed", values.len(), rows.len(), columns.len()));
    }
    Ok((side, Block::Matrix(Matrix { rows, columns, values })))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used)]
    use super::*;
    use crate::vector::V3;

    /// An XML with one ring of 1 and one of 4 patches, or a tree, in one block.
    fn table(structure: &str, direction: &str, data: &str) -> Result<ScatterTable> {
        let ring = |low: f64, high: f64, n: usize| {
            format!(
                "<AngleBasisBlock><Theta>0</Theta><nPhis>{n}</nPhis><ThetaBounds><LowerTheta>{low}</LowerTheta>\
                 <UpperTheta>{high}</UpperTheta></ThetaBounds></AngleBasisBlock>"
            )
        };
        let text = format!(
            "<WindowElement xmlns=\"http://windows.lbl.gov\"><Layer><DataDefinition>\
             <IncidentDataStructure>{structure}</IncidentDataStructure><AngleBasis><AngleBasisName>Small</AngleBasisName>\
             {}{}</AngleBasis></DataDefinition><WavelengthData><Wavelength unit=\"Integral\">Visible</Wavelength>\
             <WavelengthDataBlock><WavelengthDataDirection>{direction}</WavelengthDataDirection>\
             <ColumnAngleBasis>Small</ColumnAngleBasis><RowAngleBasis>Small</RowAngleBasis>\
             <ScatteringData>{data}</ScatteringData></WavelengthDataBlock></WavelengthData></Layer></WindowElement>",
            ring(0.0, 30.0, 1),
            ring(30.0, 90.0, 4)
        );
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("t.xml");
        std::fs::write(&path, text).unwrap();
        ScatterTable::read(&path)
    }

    fn at(table: &ScatterTable, side: Side, s: V3, u: V3) -> f64 {
        table.lookup(side, [-s.x, -s.y]).map_or(0.0, |l| l.at([u.x, u.y]))
    }

    /// Entry at incident (60, 90), outgoing (60, 0): light travels up, so the source is below, at azimuth 270; only
    /// that source and that direction answer. Read backwards it is light from (60, 0) on the interior going to where
    /// the source was.
    #[test]
    fn a_single_entry_answers_to_one_pair_of_directions_and_its_reverse() {
        let mut values = vec!["0.0"; 25];
        values[5 + 2] = "3.5"; // row 1 = (60, 0), column 2 = (60, 90)
        let table = table("Columns", "Transmission Front", &values.join(", ")).unwrap();
        assert_eq!(table.sides(), [Side::TransmissionFront, Side::TransmissionBack]);
        let angle = |theta: f64, phi: f64| V3::polar(f64::to_radians(theta), f64::to_radians(phi));
        let (source, out) = (angle(120.0, 270.0), angle(60.0, 0.0));
        assert_eq!(at(&table, Side::TransmissionFront, source, out), 3.5);
        for phi in [0.0, 90.0, 180.0] {
            assert_eq!(at(&table, Side::TransmissionFront, angle(120.0, phi), out), 0.0);
            assert_eq!(at(&table, Side::TransmissionFront, source, angle(60.0, phi + 90.0)), 0.0);
        }
        assert_eq!(at(&table, Side::TransmissionBack, out, source), 3.5);
        assert_eq!(at(&table, Side::TransmissionBack, angle(60.0, 180.0), source), 0.0);
        assert_eq!(at(&table, Side::ReflectionFront, source, angle(120.0, 0.0)), 0.0);
    }

    /// Rank 3: the peak follows the azimuth of the light.
    #[test]
    fn an_isotropic_tree_turns_with_the_light() {
        // d0 lower half only; of (d1, d2) the cell of large x (d1 upper) and upper y (d2 upper).
        let table = table("TensorTree3", "Reflection Front", "{ 0 0 0 7 0 0 0 0 }").unwrap();
        for source in [10.0f64, 77.0, 200.0, 305.0] {
            let s = V3::polar(f64::to_radians(130.0), source.to_radians());
            let travel = source + 180.0;
            let seen = |turn: f64| {
                let u = V3::polar(f64::to_radians(140.0), (travel + turn).to_radians());
                at(&table, Side::ReflectionFront, s, u)
            };
            assert_eq!([seen(45.0), seen(-45.0), seen(135.0), seen(225.0)], [7.0, 0.0, 0.0, 0.0], "{source}");
        }
    }

    #[test]
    fn wrong_files_say_what_is_wrong() {
        let few = table("Columns", "Transmission Front", "1 2 3").unwrap_err().to_string();
        assert!(few.contains("3 numbers, 5 x 5 are needed"), "{few}");
        let rows = table("Rows", "Transmission Front", "").unwrap_err().to_string();
        assert!(rows.contains("`Rows`; Columns, TensorTree3 and TensorTree4"), "{rows}");
        let word = table("Columns", "Sideways", "").unwrap_err().to_string();
        assert!(word.contains("`Sideways` is none of the four"), "{word}");
    }
}
