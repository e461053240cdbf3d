//! Frames whose pixels hold several values become pictures of one colour each: RGB as it is, YUYV by ITU-R BT.601.

use goniod_drivers::frame::{PixelFormat, Pixels};

/// The pictures of one colour that a frame consists of: itself for one value a pixel, else red, green and blue.
pub fn planes(format: PixelFormat, pixels: Pixels) -> Vec<Pixels> {
    match (format, &pixels) {
        (PixelFormat::Rgb8, Pixels::U8(v)) => {
            let colour = |c: usize| Pixels::U8(v.iter().skip(c).step_by(3).copied().collect());
            vec![colour(0), colour(1), colour(2)]
        }
        (PixelFormat::Yuyv8, Pixels::U8(v)) => yuyv(v),
        _ => vec![pixels],
    }
}

/// Luma 16 to 235, chroma 16 to 240 about 128, shared by two pixels: Y0 Cb Y1 Cr.
fn yuyv(values: &[u8]) -> Vec<Pixels> {
    let mut colours = [const { Vec::new() }; 3];
    for [y0, cb, y1, cr] in values.as_chunks::<4>().0 {
        let (cb, cr) = (f64::from(*cb) - 128.0, f64::from(*cr) - 128.0);
        for y in [y0, y1] {
            let y = (f64::from(*y) - 16.0) * 255.0 / 219.0;
            let rgb = [y + 1.596_03 * cr, y - 0.391_76 * cb - 0.812_97 * cr, y + 2.017_23 * cb];
            for (colour, value) in colours.iter_mut().zip(rgb) {
                colour.push(value.round().clamp(0.0, 255.0) as u8);
            }
        }
    }
    colours.into_iter().map(Pixels::U8).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bytes<const N: usize>(values: [u8; N]) -> Pixels {
        Pixels::U8(values.to_vec())
    }

    #[test]
    fn rgb_comes_apart_and_raw_frames_stay_as_they_are() {
        let rgb = planes(PixelFormat::Rgb8, bytes([1, 2, 3, 4, 5, 6]));
        assert_eq!(rgb, [bytes([1, 4]), bytes([2, 5]), bytes([3, 6])]);
        assert_eq!(planes(PixelFormat::BayerBggr8, bytes([1, 2])), [bytes([1, 2])]);
        assert_eq!(planes(PixelFormat::Mono12, Pixels::U16(vec![7])), [Pixels::U16(vec![7])]);
    }

    /// Black, white and the primaries of BT.601 (Y, Cb, Cr = 81, 90, 240 for red, 145, 54, 34 green, 41, 240, 110 blue).
    #[test]
    fn yuyv_gives_the_colours_of_bt_601() {
        let of = |y: u8, cb: u8, cr: u8| planes(PixelFormat::Yuyv8, bytes([y, cb, y, cr]));
        let cases = [
            ((16, 128, 128), [0, 0, 0]),
            ((235, 128, 128), [255, 255, 255]),
            ((81, 90, 240), [254, 0, 0]),
            ((145, 54, 34), [0, 255, 1]),
            ((41, 240, 110), [0, 0, 255]),
        ];
        for ((y, cb, cr), rgb) in cases {
            assert_eq!(of(y, cb, cr), rgb.map(|c| bytes([c, c])), "Y {y}, Cb {cb}, Cr {cr}");
        }
    }
}
