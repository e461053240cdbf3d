//! A drawing surface with smooth edges: drawn at twice the size, averaged down, written as PNG.

use super::PlotError;
use super::colour::INK;
use crate::archive::disk::{commit_file, temporary_name};
use crate::products::export::ExportError;
use plotters::coord::Shift;
use plotters::prelude::*;
use plotters::style::{register_font, text_anchor::Pos};
use std::path::Path;
use std::sync::OnceLock;

pub use plotters::style::text_anchor::{HPos, VPos};

/// Name that the bundled font (DejaVu Sans) is registered under.
const FONT: &str = "goniod";
/// Drawn pixels per finished pixel along each axis.
const FINE: i32 = 2;

/// A finished picture: RGB, row by row.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Picture {
    /// Width and height in pixels.
    pub size: (u32, u32),
    /// Three bytes a pixel.
    pub rgb: Vec<u8>,
}

/// The surface; all coordinates and sizes in finished pixels.
pub struct Canvas<'a> {
    area: DrawingArea<BitMapBackend<'a>, Shift>,
}

/// How a text stands at its point.
#[derive(Clone, Copy)]
pub struct Ink {
    /// Height of the font in pixels.
    pub size: f64,
    /// Colour.
    pub colour: RGBColor,
    /// Bold face.
    pub bold: bool,
    /// Horizontal and vertical anchor.
    pub anchor: (HPos, VPos),
    /// Turned by 90 degrees, reading upwards.
    pub upright: bool,
}

/// Draws a picture of `size` on white.
///
/// # Errors
/// [`PlotError::Drawing`], and what `draw` returns.
pub fn picture(size: (u32, u32), draw: impl FnOnce(&Canvas) -> Result<(), PlotError>) -> Result<Picture, PlotError> {
    fonts()?;
    let fine = (size.0 * FINE as u32, size.1 * FINE as u32);
    let mut buffer = vec![255; fine.0 as usize * fine.1 as usize * 3];
    {
        let area = BitMapBackend::with_buffer(&mut buffer, fine).into_drawing_area();
        let canvas = Canvas { area };
        draw(&canvas)?;
        canvas.area.present().map_err(drawing)?;
    }
    Ok(Picture { size, rgb: averaged(&buffer, size) })
}

fn averaged(fine: &[u8], (width, height): (u32, u32)) -> Vec<u8> {
    let (w, n) = (width as usize, FINE as usize);
    let mut rgb = Vec::with_capacity(w * height as usize * 3);
    for rows in fine.chunks_exact(w * n * 3 * n) {
        for x in 0..w {
            for c in 0..3 {
                let sum: u32 = rows
                    .chunks_exact(w * n * 3)
                    .flat_map(|row| row.iter().skip(x * n * 3 + c).step_by(3).take(n))
                    .map(|&v| u32::from(v))
                    .sum();
                rgb.push((sum / (n * n) as u32) as u8);
            }
        }
    }
    rgb
}

fn fonts() -> Result<(), PlotError> {
    static DONE: OnceLock<bool> = OnceLock::new();
    let done = DONE.get_or_init(|| {
        let regular = include_bytes!("../../../assets/fonts/DejaVuSans.ttf");
        let bold = include_bytes!("../../../assets/fonts/DejaVuSans-Bold.ttf");
        register_font(FONT, FontStyle::Normal, regular).is_ok() && register_font(FONT, FontStyle::Bold, bold).is_ok()
    });
    if *done { Ok(()) } else { Err(PlotError::Drawing("the bundled font cannot be read".to_owned())) }
}

fn drawing<E: std::fmt::Display>(error: E) -> PlotError {
    PlotError::Drawing(error.to_string())
}

// === impl Picture ===

impl Picture {
    /// Writes it as PNG: temporary name, fsync, rename.
    ///
    /// # Errors
    /// [`PlotError::Drawing`] from the encoder, [`PlotError::File`] from the file system.
    pub fn write(&self, path: &Path) -> Result<(), PlotError> {
        let temporary = temporary_name(path).with_extension("png");
        {
            let mut backend = BitMapBackend::new(&temporary, self.size);
            backend.blit_bitmap((0, 0), self.size, &self.rgb).map_err(drawing)?;
            backend
                .present()
                .map_err(|e| ExportError::Io { path: path.to_owned(), source: std::io::Error::other(e.to_string()) })?;
        }
        commit_file(&temporary, path).map_err(|e| PlotError::from(ExportError::from(e)))
    }

    /// Colour of one pixel, for tests and for those who want to look closely; black outside.
    pub fn pixel(&self, x: u32, y: u32) -> [u8; 3] {
        let at = (y as usize * self.size.0 as usize + x as usize) * 3;
        match self.rgb.get(at..at + 3) {
            Some([r, g, b]) if x < self.size.0 => [*r, *g, *b],
            _ => [0; 3],
        }
    }
}

// === impl Ink ===

impl Ink {
    /// Ordinary text, anchored left and middle.
    pub fn new(size: f64) -> Ink {
        Ink { size, colour: INK, bold: false, anchor: (HPos::Left, VPos::Center), upright: false }
    }

    /// The same in another colour.
    pub fn colour(self, colour: RGBColor) -> Ink {
        Ink { colour, ..self }
    }

    /// The same in bold.
    pub fn bold(self) -> Ink {
        Ink { bold: true, ..self }
    }

    /// The same, centred about its point.
    pub fn centred(self) -> Ink {
        Ink { anchor: (HPos::Center, self.anchor.1), ..self }
    }

    /// The same, ending at its point.
    pub fn right(self) -> Ink {
        Ink { anchor: (HPos::Right, self.anchor.1), ..self }
    }
}

// === impl Canvas ===

impl Canvas<'_> {
    fn fine(&self, (x, y): (f64, f64)) -> (i32, i32) {
        ((x * f64::from(FINE)).round() as i32, (y * f64::from(FINE)).round() as i32)
    }

    /// A text at a point.
    pub fn text(&self, text: &str, at: (f64, f64), ink: Ink) -> Result<(), PlotError> {
        let style = if ink.bold { FontStyle::Bold } else { FontStyle::Normal };
        let mut font = FontDesc::new(FontFamily::Name(FONT), ink.size * f64::from(FINE), style);
        if ink.upright {
            font = font.transform(FontTransform::Rotate270);
        }
        let style = TextStyle::from(font).color(&ink.colour).pos(Pos::new(ink.anchor.0, ink.anchor.1));
        self.area.draw(&Text::new(text.to_owned(), self.fine(at), style)).map_err(drawing)
    }

    /// A line through some points.
    pub fn line(&self, points: &[(f64, f64)], colour: RGBColor, width: f64) -> Result<(), PlotError> {
        let points: Vec<_> = points.iter().map(|&p| self.fine(p)).collect();
        let stroke = (width * f64::from(FINE)).round().max(1.0) as u32;
        self.area.draw(&PathElement::new(points, colour.stroke_width(stroke))).map_err(drawing)
    }

    /// A filled polygon.
    pub fn polygon(&self, points: &[(f64, f64)], colour: RGBColor) -> Result<(), PlotError> {
        let points: Vec<_> = points.iter().map(|&p| self.fine(p)).collect();
        self.area.draw(&Polygon::new(points, colour.filled())).map_err(drawing)
    }

    /// A filled rectangle.
    pub fn rectangle(&self, a: (f64, f64), b: (f64, f64), colour: RGBColor) -> Result<(), PlotError> {
        self.area.draw(&Rectangle::new([self.fine(a), self.fine(b)], colour.filled())).map_err(drawing)
    }

    /// A circle line.
    pub fn ring(&self, centre: (f64, f64), radius: f64, colour: RGBColor, width: f64) -> Result<(), PlotError> {
        let points: Vec<_> = (0..=180)
            .map(|i| {
                let (s, c) = (f64::from(i) * 2.0).to_radians().sin_cos();
                (centre.0 + radius * c, centre.1 - radius * s)
            })
            .collect();
        self.line(&points, colour, width)
    }

    /// Colours every drawn pixel within `radius` of `centre` by `paint(dx, dy)`, offsets in finished pixels, y up.
    pub fn disc(&self, centre: (f64, f64), radius: f64, paint: impl Fn(f64, f64) -> RGBColor) -> Result<(), PlotError> {
        let (cx, cy) = self.fine(centre);
        let reach = (radius * f64::from(FINE)).ceil() as i32;
        for y in -reach..=reach {
            for x in -reach..=reach {
                let (dx, dy) = (f64::from(x) / f64::from(FINE), -f64::from(y) / f64::from(FINE));
                if dx.hypot(dy) <= radius {
                    self.area.draw_pixel((cx + x, cy + y), &paint(dx, dy)).map_err(drawing)?;
                }
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn a_picture_has_smooth_edges_and_repeats_to_the_byte() {
        let draw = || {
            picture((60, 40), |c| {
                c.polygon(&[(5.0, 35.0), (55.0, 35.0), (55.0, 5.0)], RGBColor(0, 0, 0))?;
                c.text("θ", (5.0, 12.0), Ink::new(14.0))
            })
            .unwrap()
        };
        let a = draw();
        assert_eq!(a, draw());
        assert_eq!(a.pixel(50, 30), [0, 0, 0]);
        assert!(a.rgb.iter().any(|&v| v > 60 && v < 200), "no half tones at the edge");
        let folder = tempfile::tempdir().unwrap();
        let (one, two) = (folder.path().join("1.png"), folder.path().join("2.png"));
        a.write(&one).unwrap();
        a.write(&two).unwrap();
        let bytes = std::fs::read(one).unwrap();
        assert!(bytes.starts_with(b"\x89PNG") && bytes == std::fs::read(two).unwrap());
    }
}
