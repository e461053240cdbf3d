//! The frame store: Zarr v3 under `frames.zarr/`, one array a camera with dimensions view, exposure, row, column.
//!
//! One chunk is one frame and one immutable file (`<camera>/c.VIEW.EXPOSURE.0.0`): zstd level 1, then crc32c. Encoding and
//! decoding are those of the crate zarrs; the files themselves go through [`Disk`], which no kill can cut short.
//! Source: Zarr core specification version 3 (zarr-specs.readthedocs.io), dot separator of the default key encoding.

use super::disk::{Disk, make_folders};
use super::error::{ArchiveError, Result};
use super::layout::ArrayLayout;
use crate::digest::sha256_hex;
use goniod_drivers::frame::{PixelFormat, Pixels};
use std::collections::BTreeMap;
use std::num::NonZeroU64;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use zarrs::array::codec::{Crc32cCodec, ZstdCodec};
use zarrs::array::{Array, ArrayBuilder, ArrayBytes, ArrayToBytesCodecTraits, CodecOptions, data_type};
use zarrs::metadata::ChunkKeySeparator;

/// Name of the store inside a run directory.
pub const FRAMES: &str = "frames.zarr";

/// Fast and strong enough: frames are mostly noise (measured in the stack notes: 200 MB/s, 1.7 to 1).
const ZSTD_LEVEL: i32 = 1;

/// The frame arrays of a run.
pub struct FrameStore {
    root: PathBuf,
    disk: Arc<dyn Disk>,
    arrays: BTreeMap<String, CameraArray>,
}

/// What is known of a frame that reached the disk.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Stored {
    /// SHA-256 of the chunk file, hexadecimal.
    pub digest: String,
    /// Size of the chunk file.
    pub bytes: u64,
}

struct CameraArray {
    layout: ArrayLayout,
    zarr: Array<()>,
    chunk: Vec<NonZeroU64>,
}

// === impl FrameStore ===

impl FrameStore {
    /// The store under `run` for arrays of these shapes; touches no file.
    ///
    /// # Errors
    /// [`ArchiveError::NoPlace`] for an array without extent.
    pub fn new(run: &Path, arrays: &[ArrayLayout], disk: Arc<dyn Disk>) -> Result<FrameStore> {
        let root = run.join(FRAMES);
        let arrays = arrays
            .iter()
            .map(|layout| Ok((layout.camera.clone(), CameraArray::new(layout)?)))
            .collect::<Result<_>>()?;
        Ok(FrameStore { root, disk, arrays })
    }

    /// The metadata files of group and arrays, path relative to the run directory and bytes.
    ///
    /// # Errors
    /// [`ArchiveError::Codec`] when the metadata cannot be put into JSON.
    pub fn metadata_files(&self) -> Result<Vec<(PathBuf, Vec<u8>)>> {
        let group = serde_json::json!({ "zarr_format": 3, "node_type": "group", "attributes": {} });
        let mut files = vec![(Path::new(FRAMES).join("zarr.json"), pretty(&group)?)];
        for (camera, array) in &self.arrays {
            files.push((Path::new(FRAMES).join(camera).join("zarr.json"), pretty(array.zarr.metadata())?));
        }
        Ok(files)
    }

    /// Encodes and stores one frame; afterwards it survives a power failure. Runs for milliseconds: call it on a
    /// blocking thread.
    ///
    /// # Errors
    /// [`ArchiveError::NoPlace`] where camera, indices, size or depth do not fit; [`ArchiveError::Full`] and
    /// [`ArchiveError::Failing`] from the disk; nothing is then changed.
    pub fn put_frame(&self, camera: &str, array_index: u32, exposure_index: u32, pixels: &Pixels) -> Result<Stored> {
        let array = self.place(camera, array_index, exposure_index)?;
        let path = self.chunk_path(camera, array_index, exposure_index);
        let encoded = array.encode(pixels, &path)?;
        if let Some(folder) = path.parent() {
            make_folders(&*self.disk, folder)?;
        }
        self.disk.write_atomic(&path, &encoded).map_err(|e| ArchiveError::io("write the frame", &path, &e))?;
        Ok(Stored { digest: sha256_hex(&encoded), bytes: encoded.len() as u64 })
    }

    /// Reads one frame, row by row; `None` when it was never stored.
    ///
    /// # Errors
    /// [`ArchiveError::NoPlace`] outside the array, [`ArchiveError::Codec`] for a damaged chunk.
    pub fn read_frame(&self, camera: &str, array_index: u32, exposure_index: u32) -> Result<Option<Pixels>> {
        self.read(camera, array_index, exposure_index, None)
    }

    /// As [`FrameStore::read_frame`], and proves by its digest that it is the frame that was stored in this place.
    ///
    /// # Errors
    /// As [`FrameStore::read_frame`], and [`ArchiveError::Damaged`] for any other file.
    pub fn read_proven(&self, camera: &str, array: u32, exposure: u32, digest: &str) -> Result<Option<Pixels>> {
        self.read(camera, array, exposure, Some(digest))
    }

    fn read(
        &self,
        camera: &str,
        array_index: u32,
        exposure_index: u32,
        digest: Option<&str>,
    ) -> Result<Option<Pixels>> {
        let array = self.place(camera, array_index, exposure_index)?;
        let path = self.chunk_path(camera, array_index, exposure_index);
        let encoded = match std::fs::read(&path) {
            Ok(encoded) => encoded,
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(None),
            Err(e) => return Err(ArchiveError::io("read the frame", &path, &e)),
        };
        if digest.is_some_and(|digest| sha256_hex(&encoded) != digest) {
            return Err(ArchiveError::damaged(&path, "it is not the frame that was stored here"));
        }
        array.decode(encoded, &path).map(Some)
    }

    /// The file of one frame, whether it is there or not.
    pub fn chunk_path(&self, camera: &str, array_index: u32, exposure_index: u32) -> PathBuf {
        self.root.join(camera).join(format!("c.{array_index}.{exposure_index}.0.0"))
    }

    /// The shapes of the arrays, by camera.
    pub fn layouts(&self) -> impl Iterator<Item = &ArrayLayout> {
        self.arrays.values().map(|array| &array.layout)
    }

    fn place(&self, camera: &str, array_index: u32, exposure_index: u32) -> Result<&CameraArray> {
        match self.arrays.get(camera) {
            Some(a) if array_index < a.layout.views && exposure_index < a.layout.exposures => Ok(a),
            _ => Err(ArchiveError::NoPlace {
                what: format!("camera {camera}, view {array_index}, exposure {exposure_index}"),
            }),
        }
    }
}

// === impl CameraArray ===

impl CameraArray {
    fn new(layout: &ArrayLayout) -> Result<CameraArray> {
        let no_place = |why: String| ArchiveError::NoPlace { what: format!("array {}: {why}", layout.camera) };
        let frame = [1, 1, layout.rows as u64, layout.columns as u64];
        let chunk: Option<Vec<NonZeroU64>> = frame.iter().map(|n| NonZeroU64::new(*n)).collect();
        let chunk = chunk.ok_or_else(|| no_place(format!("{} x {} pixels", layout.columns, layout.rows)))?;
        let shape = vec![u64::from(layout.views), u64::from(layout.exposures), frame[2], frame[3]];
        let mut builder = if layout.format.levels() > 256 {
            ArrayBuilder::new(shape, frame.to_vec(), data_type::uint16(), 0_u16)
        } else {
            ArrayBuilder::new(shape, frame.to_vec(), data_type::uint8(), 0_u8)
        };
        builder
            .dimension_names(["view", "exposure", "row", "column"].into())
            .chunk_key_encoding_default_separator(ChunkKeySeparator::Dot)
            .bytes_to_bytes_codecs(vec![Arc::new(ZstdCodec::new(ZSTD_LEVEL, false)), Arc::new(Crc32cCodec::new())]);
        if let Ok(format) = serde_json::to_value(layout.format) {
            builder.attributes_mut().insert("pixel_format".to_owned(), format);
        }
        if let Some(caution) = layout.format.caution() {
            builder.attributes_mut().insert("caution".to_owned(), caution.into());
        }
        let zarr = builder.build(Arc::new(()), &format!("/{}", layout.camera)).map_err(|e| no_place(e.to_string()))?;
        Ok(CameraArray { layout: layout.clone(), zarr, chunk })
    }

    fn encode(&self, pixels: &Pixels, path: &Path) -> Result<Vec<u8>> {
        let wide = self.layout.format.levels() > 256;
        let raw = match pixels {
            Pixels::U8(v) if !wide => v.clone(),
            // A camera that sums long exposures gives its short ones as they are.
            Pixels::U8(v) if matches!(self.layout.format, PixelFormat::Summed { .. }) => {
                v.iter().flat_map(|b| u16::from(*b).to_ne_bytes()).collect()
            }
            Pixels::U16(v) if wide => v.iter().flat_map(|w| w.to_ne_bytes()).collect(),
            _ => return Err(self.misfit("other depth")),
        };
        if pixels.len() != self.layout.rows * self.layout.columns {
            return Err(self.misfit(&format!("{} pixels", pixels.len())));
        }
        let bytes = ArrayBytes::new_flen(raw);
        let zarr = &self.zarr;
        zarr.codecs()
            .encode(bytes, &self.chunk, zarr.data_type(), zarr.fill_value(), &CodecOptions::default())
            .map(|encoded| encoded.into_owned())
            .map_err(|e| codec_error("encoded", path, e))
    }

    fn decode(&self, encoded: Vec<u8>, path: &Path) -> Result<Pixels> {
        let zarr = &self.zarr;
        let raw = zarr
            .codecs()
            .decode(encoded.into(), &self.chunk, zarr.data_type(), zarr.fill_value(), &CodecOptions::default())
            .and_then(|bytes| Ok(bytes.into_fixed()?.into_owned()))
            .map_err(|e| codec_error("decoded", path, e))?;
        let wide = self.layout.format.levels() > 256;
        let width = if wide { 2 } else { 1 };
        if raw.len() != self.layout.rows * self.layout.columns * width {
            return Err(codec_error("decoded", path, format!("{} bytes", raw.len())));
        }
        Ok(if wide {
            Pixels::U16(raw.as_chunks::<2>().0.iter().map(|pair| u16::from_ne_bytes(*pair)).collect())
        } else {
            Pixels::U8(raw)
        })
    }

    fn misfit(&self, what: &str) -> ArchiveError {
        let ArrayLayout { camera, rows, columns, format, .. } = &self.layout;
        ArchiveError::NoPlace { what: format!("camera {camera}: {what} instead of {columns} x {rows} {format:?}") }
    }
}

fn codec_error(what: &'static str, path: &Path, error: impl std::fmt::Display) -> ArchiveError {
    ArchiveError::Codec { what, path: path.to_path_buf(), message: error.to_string() }
}

fn pretty(value: &impl serde::Serialize) -> Result<Vec<u8>> {
    serde_json::to_vec_pretty(value).map_err(|e| codec_error("encoded", Path::new("zarr.json"), e))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used)]
    use super::*;
    use crate::archive::disk::RealDisk;
    use goniod_drivers::frame::PixelFormat;

    fn layout(camera: &str, format: PixelFormat) -> ArrayLayout {
        ArrayLayout { camera: camera.to_owned(), views: 3, exposures: 2, rows: 6, columns: 8, format }
    }

    fn store(run: &Path) -> FrameStore {
        let arrays = [layout("ccd", PixelFormat::BayerRggb8), layout("ingaas", PixelFormat::Mono12)];
        FrameStore::new(run, &arrays, Arc::new(RealDisk)).unwrap()
    }

    #[test]
    fn frames_come_back_as_they_were_and_missing_ones_are_none() {
        let run = tempfile::tempdir().unwrap();
        let store = store(run.path());
        let eight = Pixels::U8((0..48).collect());
        let twelve = Pixels::U16((0..48).map(|i| i * 85).collect());
        let stored = store.put_frame("ccd", 2, 1, &eight).unwrap();
        store.put_frame("ingaas", 0, 0, &twelve).unwrap();
        assert_eq!(store.read_frame("ccd", 2, 1).unwrap(), Some(eight));
        assert_eq!(store.read_frame("ingaas", 0, 0).unwrap(), Some(twelve));
        assert_eq!(store.read_frame("ccd", 0, 0).unwrap(), None);
        let file = std::fs::read(store.chunk_path("ccd", 2, 1)).unwrap();
        assert_eq!((stored.bytes, stored.digest), (file.len() as u64, sha256_hex(&file)));
    }

    /// A chunk equal to the fill value must be a file all the same: it was measured.
    #[test]
    fn a_frame_of_zeros_is_stored_and_is_not_missing() {
        let run = tempfile::tempdir().unwrap();
        let store = store(run.path());
        store.put_frame("ccd", 0, 0, &Pixels::U8(vec![0; 48])).unwrap();
        assert_eq!(store.read_frame("ccd", 0, 0).unwrap(), Some(Pixels::U8(vec![0; 48])));
    }

    #[test]
    fn what_does_not_fit_is_refused_in_one_sentence() {
        let run = tempfile::tempdir().unwrap();
        let store = store(run.path());
        let frame = Pixels::U8(vec![7; 48]);
        for bad in [
            store.put_frame("ccd", 3, 0, &frame),
            store.put_frame("ccd", 0, 2, &frame),
            store.put_frame("other", 0, 0, &frame),
            store.put_frame("ingaas", 0, 0, &frame),
            store.put_frame("ccd", 0, 0, &Pixels::U8(vec![7; 47])),
        ] {
            assert!(matches!(bad, Err(ArchiveError::NoPlace { .. })));
        }
    }

    #[test]
    fn any_flipped_bit_of_a_chunk_fails_its_checksum() {
        let run = tempfile::tempdir().unwrap();
        let store = store(run.path());
        store.put_frame("ccd", 0, 0, &Pixels::U8((0..48).collect())).unwrap();
        let path = store.chunk_path("ccd", 0, 0);
        let good = std::fs::read(&path).unwrap();
        for bit in 0..good.len() * 8 {
            let mut bad = good.clone();
            bad[bit / 8] ^= 1 << (bit % 8);
            std::fs::write(&path, bad).unwrap();
            assert!(store.read_frame("ccd", 0, 0).is_err(), "bit {bit}");
        }
    }

    /// The metadata that xarray and zarr-python look at (Zarr v3 core, array metadata).
    #[test]
    fn array_metadata_is_zarr_version_3() {
        let run = tempfile::tempdir().unwrap();
        let files = store(run.path()).metadata_files().unwrap();
        assert_eq!(files.len(), 3);
        let ccd: serde_json::Value = serde_json::from_slice(&files[1].1).unwrap();
        assert_eq!(ccd["zarr_format"], 3);
        assert_eq!(ccd["shape"], serde_json::json!([3, 2, 6, 8]));
        assert_eq!(ccd["dimension_names"], serde_json::json!(["view", "exposure", "row", "column"]));
        assert_eq!(ccd["data_type"], "uint8");
        assert_eq!(ccd["chunk_key_encoding"]["configuration"]["separator"], ".");
        let names: Vec<_> = ccd["codecs"].as_array().unwrap().iter().map(|c| c["name"].clone()).collect();
        assert_eq!(names, ["bytes", "zstd", "crc32c"]);
        let ingaas: serde_json::Value = serde_json::from_slice(&files[2].1).unwrap();
        assert_eq!(ingaas["data_type"], "uint16");
        assert_eq!(ingaas["codecs"][0]["configuration"]["endian"], "little");
    }
}
