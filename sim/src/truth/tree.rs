//! Tensor trees (Radiance) as a sample's law: nodes over the unit cube of Shirley-Chiu squares.

use std::f64::consts::FRAC_PI_4;

/// A node over a cube of `rank` dimensions.
#[derive(Debug, Clone, PartialEq)]
pub enum Node {
    /// 2^rank children; bit i of the number is the upper half of dimension i.
    Branch(Vec<Node>),
    /// A grid of `side` cells along each dimension, dimension 0 slowest.
    Leaf {
        /// Cells along a dimension.
        side: usize,
        /// Values in 1/sr.
        values: Vec<f64>,
    },
}

/// A tree of rank 3 (isotropic) or 4.
#[derive(Debug, Clone, PartialEq)]
pub struct Tree {
    rank: usize,
    root: Node,
}

/// Reads tokens of a tree's text.
struct Reader<'a> {
    tokens: std::iter::Peekable<std::vec::IntoIter<&'a str>>,
    rank: usize,
}

/// Deepest nesting accepted.
const DEEPEST: usize = 12;

/// Unit disc (x, y) to the unit square, area preserving (concentric map, inverse form).
pub fn disc_to_square(p: [f64; 2]) -> [f64; 2] {
    let [x, y] = p;
    let r = x.hypot(y);
    if r == 0.0 {
        return [0.5, 0.5];
    }
    let (a, b) = if x.abs() >= y.abs() {
        let a = r.copysign(x);
        (a, a * (y / x).atan() / FRAC_PI_4)
    } else {
        let b = r.copysign(y);
        (b * (x / y).atan() / FRAC_PI_4, b)
    };
    [0.5 * (1.0 + a), 0.5 * (1.0 + b)]
}

/// Unit square to the unit disc.
pub fn square_to_disc(q: [f64; 2]) -> [f64; 2] {
    let (a, b) = (2.0 * q[0] - 1.0, 2.0 * q[1] - 1.0);
    if a == 0.0 && b == 0.0 {
        return [0.0, 0.0];
    }
    if a.abs() >= b.abs() {
        let t = FRAC_PI_4 * b / a;
        [a * t.cos(), a * t.sin()]
    } else {
        let t = FRAC_PI_4 * a / b;
        [b * t.sin(), b * t.cos()]
    }
}

// === impl Tree ===

impl Tree {
    /// Parses the text of a ScatteringData element; says what is wrong with it.
    pub fn parse(rank: usize, text: &str) -> Result<Tree, String> {
        let spaced = text.replace('{', " { ").replace('}', " } ").replace(',', " ");
        let tokens: Vec<&str> = spaced.split_whitespace().collect();
        let mut reader = Reader { tokens: tokens.into_iter().peekable(), rank };
        let root = reader.node(0)?;
        if reader.tokens.next().is_some() {
            return Err("text follows the closing brace of the tree".to_owned());
        }
        Ok(Tree { rank, root })
    }

    /// Value for in-plane travel direction `p_in` of the light and outgoing (x, y), 1/sr; negative values count as 0.
    pub fn value(&self, p_in: [f64; 2], p_out: [f64; 2]) -> f64 {
        let coordinates = if self.rank == 3 {
            let sin = p_in[0].hypot(p_in[1]).min(1.0);
            let (c, s) = if sin > 0.0 { (p_in[0] / sin, p_in[1] / sin) } else { (1.0, 0.0) };
            let turned = [p_out[0] * c + p_out[1] * s, p_out[1] * c - p_out[0] * s];
            let q = disc_to_square(turned);
            [0.5 * (1.0 - sin), q[0], q[1], 0.0]
        } else {
            let (i, o) = (disc_to_square(p_in), disc_to_square(p_out));
            [i[0], i[1], o[0], o[1]]
        };
        self.root.value(&coordinates, self.rank).max(0.0)
    }
}

// === impl Node ===

impl Node {
    fn value(&self, coordinates: &[f64; 4], rank: usize) -> f64 {
        let (mut node, mut c) = (self, *coordinates);
        for x in &mut c {
            *x = x.clamp(0.0, 1.0 - 1e-12);
        }
        while let Node::Branch(children) = node {
            let mut child = 0;
            for (i, x) in c.iter_mut().enumerate().take(rank) {
                *x *= 2.0;
                if *x >= 1.0 {
                    *x -= 1.0;
                    child |= 1 << i;
                }
            }
            match children.get(child) {
                Some(next) => node = next,
                None => return 0.0,
            }
        }
        let Node::Leaf { side, values } = node else { return 0.0 };
        let place = c.iter().take(rank).fold(0, |sum, x| sum * side + ((x * *side as f64) as usize).min(side - 1));
        values.get(place).copied().unwrap_or(0.0)
    }
}

// === impl Reader ===

impl Reader<'_> {
    fn node(&mut self, depth: usize) -> Result<Node, String> {
        if depth > DEEPEST {
            return Err(format!("the tree nests deeper than {DEEPEST} levels"));
        }
        if self.tokens.next() != Some("{") {
            return Err("a node must begin with `{`".to_owned());
        }
        let node = if self.tokens.peek() == Some(&"{") {
            let children = (0..1 << self.rank).map(|_| self.node(depth + 1)).collect::<Result<Vec<_>, _>>()?;
            Node::Branch(children)
        } else {
            self.leaf()?
        };
        match self.tokens.next() {
            Some("}") => Ok(node),
            other => Err(format!("`{}` stands where a node must end", other.unwrap_or("the end of the text"))),
        }
    }

    fn leaf(&mut self) -> Result<Node, String> {
        let mut values = Vec::new();
        while let Some(token) = self.tokens.next_if(|t| *t != "}" && *t != "{") {
            let value = token.parse::<f64>().ok().filter(|v| v.is_finite());
            values.push(value.ok_or_else(|| format!("`{token}` is not a number"))?);
        }
        let sides = (0..=DEEPEST).map(|m| 1usize << m);
        let side = sides.take_while(|s| s.pow(self.rank as u32) <= values.len()).last().unwrap_or(0);
        if values.is_empty() || side.pow(self.rank as u32) != values.len() {
            return Err(format!("a leaf has {} numbers; 2^({} m) are needed", values.len(), self.rank));
        }
        Ok(Node::Leaf { side, values })
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used)]
    use super::*;

    #[test]
    fn square_and_disc_are_inverse() {
        for (a, b) in [(0.1, 0.2), (0.9, 0.3), (0.5, 0.99), (0.3, 0.7), (0.501, 0.5)] {
            let back = disc_to_square(square_to_disc([a, b]));
            assert!((back[0] - a).abs() < 1e-12 && (back[1] - b).abs() < 1e-12, "{a} {b}: {back:?}");
        }
    }

    /// Children count with dimension 0 fastest, grids with dimension 0 slowest.
    #[test]
    fn both_spellings_of_a_cube_agree() {
        let grid = Tree::parse(3, "{ 0 1 2 3 4 5 6 7 }").unwrap();
        let branches = Tree::parse(3, "{ {0} {4} {2} {6} {1} {5} {3} {7} }").unwrap();
        for c in [[0.1, 0.6, 0.2, 0.0], [0.7, 0.1, 0.9, 0.0], [0.4, 0.2, 0.9, 0.0]] {
            assert_eq!(grid.root.value(&c, 3), branches.root.value(&c, 3));
        }
        assert_eq!(grid.root.value(&[0.9, 0.1, 0.1, 0.0], 3), 4.0);
    }

    #[test]
    fn broken_text_is_told() {
        assert!(Tree::parse(3, "{ 1 2 3 }").unwrap_err().contains("3 numbers"));
        assert!(Tree::parse(4, "{ {1} {2} }").unwrap_err().contains("begin"));
        assert!(Tree::parse(3, "{ x }").unwrap_err().contains("not a number"));
    }
}
