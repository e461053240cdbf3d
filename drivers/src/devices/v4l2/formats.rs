//! V4L2 pixel formats: which one is best, how long a line is, and the one copy from the kernel's buffer into the pool's.
//!
//! Source: Linux media userspace API, "Image Formats". Words are little-endian in memory; `bytesperline` may exceed
//! width times bytes and is always used. Raw mosaics stay raw: radiometry never sees an interpolated value.

use crate::frame::{PixelFormat, Pixels};

/// A V4L2 format the driver can read, in order of preference.
const TABLE: [(&[u8; 4], PixelFormat); 25] = [
    (b"RG16", PixelFormat::BayerRggb16),
    (b"GR16", PixelFormat::BayerGrbg16),
    (b"GB16", PixelFormat::BayerGbrg16),
    (b"BYR2", PixelFormat::BayerBggr16),
    (b"RG12", PixelFormat::BayerRggb12),
    (b"BA12", PixelFormat::BayerGrbg12),
    (b"GB12", PixelFormat::BayerGbrg12),
    (b"BG12", PixelFormat::BayerBggr12),
    (b"RG10", PixelFormat::BayerRggb10),
    (b"BA10", PixelFormat::BayerGrbg10),
    (b"GB10", PixelFormat::BayerGbrg10),
    (b"BG10", PixelFormat::BayerBggr10),
    (b"RGGB", PixelFormat::BayerRggb8),
    (b"GRBG", PixelFormat::BayerGrbg8),
    (b"GBRG", PixelFormat::BayerGbrg8),
    (b"BA81", PixelFormat::BayerBggr8),
    (b"Y16 ", PixelFormat::Mono16),
    (b"Y14 ", PixelFormat::Mono14),
    (b"Y12 ", PixelFormat::Mono12),
    (b"Y10 ", PixelFormat::Mono10),
    (b"GREY", PixelFormat::Mono8),
    (b"RGB3", PixelFormat::Rgb8),
    (b"BGR3", PixelFormat::Rgb8),
    (b"YUYV", PixelFormat::Yuyv8),
    (b"UYVY", PixelFormat::Yuyv8),
];

/// How pictures lie in the kernel's buffers, as read back from the device.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Layout {
    /// Four-character code.
    pub fourcc: [u8; 4],
    /// Format of the frames made from it.
    pub format: PixelFormat,
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Bytes from line to line.
    pub bytesperline: usize,
}

/// The best of the `offered` codes: the first of the table, or the first that gives `wanted`.
pub fn choose(offered: &[[u8; 4]], wanted: Option<PixelFormat>) -> Option<([u8; 4], PixelFormat)> {
    TABLE
        .iter()
        .find(|(code, format)| offered.contains(code) && wanted.is_none_or(|w| w == *format))
        .map(|(code, format)| (**code, *format))
}

// === impl Layout ===

impl Layout {
    /// Bytes of one line's pixels.
    pub fn line_bytes(&self) -> usize {
        let word = if self.format.bits() > 8 { 2 } else { 1 };
        self.width * self.format.values_per_pixel() * word
    }

    /// Bytes a whole picture needs: all lines, the last without its padding.
    pub fn picture_bytes(&self) -> usize {
        self.bytesperline.max(self.line_bytes()) * self.height.saturating_sub(1) + self.line_bytes()
    }

    /// Copies a picture into `into` (reused where its kind fits). Pixels that a short buffer does not hold are 0.
    pub fn unpack(&self, bytes: &[u8], into: Option<Pixels>) -> Pixels {
        let values = self.width * self.format.values_per_pixel() * self.height;
        let stride = self.bytesperline.max(self.line_bytes()).max(1);
        let lines = bytes.chunks(stride).take(self.height).map(|l| &l[..l.len().min(self.line_bytes())]);
        if self.format.bits() > 8 {
            let mut out = if let Some(Pixels::U16(v)) = into { v } else { Vec::new() };
            out.clear();
            out.reserve_exact(values);
            lines.for_each(|l| out.extend(l.as_chunks().0.iter().map(|b| u16::from_le_bytes(*b))));
            out.resize(values, 0);
            return Pixels::U16(out);
        }
        let mut out = if let Some(Pixels::U8(v)) = into { v } else { Vec::new() };
        out.clear();
        out.reserve_exact(values);
        if &self.fourcc == b"BGR3" {
            lines.for_each(|l| out.extend(l.as_chunks::<3>().0.iter().flat_map(|[b, g, r]| [*r, *g, *b])));
        } else if &self.fourcc == b"UYVY" {
            lines.for_each(|l| out.extend(l.as_chunks::<2>().0.iter().flat_map(|[c, y]| [*y, *c])));
        } else {
            lines.for_each(|l| out.extend_from_slice(l));
        }
        out.resize(values, 0);
        Pixels::U8(out)
    }

    /// Most frames whose sum fits 16-bit words; 1 for formats that cannot be summed.
    pub fn summable(&self) -> u32 {
        if self.format.values_per_pixel() > 1 { 1 } else { 0xFFFF / ((1 << u32::from(self.format.bits())) - 1) }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used)]
    use super::*;

    fn layout(fourcc: &[u8; 4], width: usize, height: usize, bytesperline: usize) -> Layout {
        let format = choose(&[*fourcc], None).unwrap().1;
        Layout { fourcc: *fourcc, format, width, height, bytesperline }
    }

    #[test]
    fn raw_mosaic_comes_before_colour_and_yuyv_last() {
        let all = [*b"YUYV", *b"BGR3", *b"RGGB", *b"BG12", *b"MJPG"];
        assert_eq!(choose(&all, None), Some((*b"BG12", PixelFormat::BayerBggr12)));
        assert_eq!(choose(&all, Some(PixelFormat::BayerRggb8)), Some((*b"RGGB", PixelFormat::BayerRggb8)));
        assert_eq!(choose(&all[..2], None), Some((*b"BGR3", PixelFormat::Rgb8)));
        assert_eq!(choose(&[*b"MJPG"], None), None);
        assert!(choose(&all[..1], None).unwrap().1.caution().is_some(), "YUYV carries its warning");
    }

    #[test]
    fn padding_at_the_end_of_lines_is_never_a_pixel() {
        let l = layout(b"GREY", 3, 2, 4);
        assert_eq!(l.unpack(&[1, 2, 3, 99, 4, 5, 6, 99], None), Pixels::U8(vec![1, 2, 3, 4, 5, 6]));
        assert_eq!(l.picture_bytes(), 7);
        let words = layout(b"RG12", 2, 2, 6);
        let bytes = [0x34, 0x0A, 1, 0, 99, 99, 2, 0, 3, 0];
        assert_eq!(words.unpack(&bytes, None), Pixels::U16(vec![0x0A34, 1, 2, 3]));
    }

    #[test]
    fn bgr_becomes_rgb_and_short_pictures_end_in_zeros() {
        let l = layout(b"BGR3", 1, 2, 3);
        assert_eq!(l.unpack(&[1, 2, 3, 4, 5, 6], None), Pixels::U8(vec![3, 2, 1, 6, 5, 4]));
        assert_eq!(l.unpack(&[1, 2, 3], None), Pixels::U8(vec![3, 2, 1, 0, 0, 0]));
    }

    #[test]
    fn uyvy_becomes_yuyv() {
        assert_eq!(layout(b"UYVY", 2, 1, 4).unpack(&[1, 2, 3, 4], None), Pixels::U8(vec![2, 1, 4, 3]));
    }

    #[test]
    fn a_used_buffer_is_filled_again_without_a_new_one() {
        let l = layout(b"GREY", 2, 1, 2);
        let used = Vec::with_capacity(64);
        let at = used.as_ptr();
        let Pixels::U8(again) = l.unpack(&[7, 8], Some(Pixels::U8(used))) else { panic!("8-bit format") };
        assert_eq!((again.as_ptr(), again.as_slice()), (at, &[7, 8][..]));
    }

    #[test]
    fn sums_fit_sixteen_bits() {
        assert_eq!(layout(b"RGGB", 1, 1, 1).summable(), 257);
        assert_eq!(layout(b"Y12 ", 1, 1, 2).summable(), 16);
        assert_eq!(layout(b"Y16 ", 1, 1, 2).summable(), 1);
        assert_eq!(layout(b"YUYV", 2, 1, 4).summable(), 1);
    }
}
