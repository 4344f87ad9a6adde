//! Decode uploaded bytes into a frame, or refuse them naming the part at fault.

use super::{Distortion, Frame, Intrinsics};
use flip_core::domain::timestamp::Timestamp;
use flip_core::domain::{FieldError, bounded};
use serde::Deserialize;
use std::io::Cursor;

/// The three parts of an uploaded frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Upload {
    /// Depth: a 16-bit grey PNG, or raw Z16 values, little-endian, row by row.
    pub depth: Vec<u8>,
    /// Colour: an 8-bit RGB PNG of the same size.
    pub colour: Vec<u8>,
    /// JSON: `intrinsics` with `width`, `height`, `fx`, `fy`, `ppx`, `ppy`, `model` and five
    /// `coefficients`; `depth_unit_m`; `taken_at` (RFC 3339).
    pub description: Vec<u8>,
}

/// Maximum size of a description, bytes.
const DESCRIPTION_BYTES_MAX: usize = 4096;
/// Signature with which every PNG begins.
const PNG: [u8; 8] = [0x89, b'P', b'N', b'G', b'\r', b'\n', 0x1a, b'\n'];

/// Contents of a description. Everything is required, but a missing value is reported by field
/// instead of by position.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Description {
    intrinsics: Option<Lens>,
    depth_unit_m: Option<f64>,
    taken_at: Option<Timestamp>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Lens {
    width: Option<u32>,
    height: Option<u32>,
    fx: Option<f64>,
    fy: Option<f64>,
    ppx: Option<f64>,
    ppy: Option<f64>,
    model: Option<String>,
    coefficients: Option<Vec<f64>>,
}

impl Upload {
    /// Decode the frame. Sizes are checked before anything of that size is allocated; meaningless
    /// bytes are refused and never cause a panic.
    ///
    /// # Errors
    /// `description`, `intrinsics.…`, `depth_unit_m`, `taken_at`, `depth` or `colour`, and what is
    /// wrong with it.
    pub fn decode(&self) -> Result<Frame, FieldError> {
        let (intrinsics, depth_unit_m, taken_at) = read_description(&self.description)?;
        let depth = match self.depth.starts_with(&PNG) {
            true => {
                let bytes = image("depth", &self.depth, &intrinsics, Kind::DEPTH)?;
                bytes.as_chunks().0.iter().map(|pair| u16::from_be_bytes(*pair)).collect()
            }
            false => raw_depth(&self.depth, &intrinsics)?,
        };
        let colour =
            image("colour", &self.colour, &intrinsics, Kind::COLOUR)?.as_chunks().0.to_vec();
        Ok(Frame { intrinsics, depth_unit_m, depth, colour, taken_at })
    }
}

/// The description of a frame, in the format of [`Upload::description`].
pub fn description(frame: &Frame) -> Vec<u8> {
    let Frame { intrinsics, depth_unit_m, taken_at, .. } = frame;
    serde_json::json!({"intrinsics": intrinsics, "depth_unit_m": depth_unit_m, "taken_at": taken_at}).to_string().into()
}

fn missing(field: &str) -> FieldError {
    FieldError::new(field, "is missing: every frame must say it, nothing is assumed")
}

fn read_description(bytes: &[u8]) -> Result<(Intrinsics, f64, Timestamp), FieldError> {
    if bytes.len() > DESCRIPTION_BYTES_MAX {
        let got = bytes.len();
        return Err(FieldError::new(
            "description",
            format!("must have at most {DESCRIPTION_BYTES_MAX} bytes, got {got}"),
        ));
    }
    let said: Description = serde_json::from_slice(bytes).map_err(|error| {
        FieldError::new("description", format!("must be the JSON of a frame: {error}"))
    })?;
    let lens = said.intrinsics.ok_or_else(|| missing("intrinsics"))?;
    let number = |field: &str, value: Option<f64>| {
        value.ok_or_else(|| missing(&format!("intrinsics.{field}")))
    };
    let side = |field: &str, value: Option<u32>| {
        value.ok_or_else(|| missing(&format!("intrinsics.{field}")))
    };
    let model = Distortion::named(
        "intrinsics.model",
        &lens.model.ok_or_else(|| missing("intrinsics.model"))?,
    )?;
    let coefficients = lens.coefficients.ok_or_else(|| missing("intrinsics.coefficients"))?;
    let coefficients = coefficients.try_into().map_err(|got: Vec<f64>| {
        FieldError::new(
            "intrinsics.coefficients",
            format!("must be five numbers k1, k2, p1, p2, k3, got {}", got.len()),
        )
    })?;
    let intrinsics = Intrinsics {
        width: side("width", lens.width)?,
        height: side("height", lens.height)?,
        fx: number("fx", lens.fx)?,
        fy: number("fy", lens.fy)?,
        ppx: number("ppx", lens.ppx)?,
        ppy: number("ppy", lens.ppy)?,
        model,
        coefficients,
    };
    let unit = said.depth_unit_m.ok_or_else(|| missing("depth_unit_m"))?;
    bounded("depth_unit_m", unit, 1e-6, 0.01, "m")?;
    Ok((intrinsics.checked()?, unit, said.taken_at.ok_or_else(|| missing("taken_at"))?))
}

fn raw_depth(bytes: &[u8], intrinsics: &Intrinsics) -> Result<Vec<u16>, FieldError> {
    let wanted = 2 * intrinsics.pixels();
    if bytes.len() != wanted {
        let (width, height, got) = (intrinsics.width, intrinsics.height, bytes.len());
        let advice = format!(
            "must be a PNG or {wanted} bytes ({width} x {height} values of Z16), got {got} bytes"
        );
        return Err(FieldError::new("depth", advice));
    }
    Ok(bytes.as_chunks().0.iter().map(|pair| u16::from_le_bytes(*pair)).collect())
}

/// Required format of a PNG.
#[derive(Clone, Copy)]
struct Kind {
    colour: png::ColorType,
    bits: png::BitDepth,
    bytes: usize,
    words: &'static str,
}

impl Kind {
    const DEPTH: Self = Self {
        colour: png::ColorType::Grayscale,
        bits: png::BitDepth::Sixteen,
        bytes: 2,
        words: "16 bit grey",
    };
    const COLOUR: Self = Self {
        colour: png::ColorType::Rgb,
        bits: png::BitDepth::Eight,
        bytes: 3,
        words: "8 bit RGB",
    };
}

fn image(
    field: &str,
    bytes: &[u8],
    intrinsics: &Intrinsics,
    kind: Kind,
) -> Result<Vec<u8>, FieldError> {
    let unreadable = |error: png::DecodingError| {
        FieldError::new(field, format!("is not a readable PNG: {error}"))
    };
    let wanted = kind.bytes * intrinsics.pixels();
    // Room for one image of this size and the decoder's own rows; a small file cannot request more.
    let limits = png::Limits { bytes: 2 * wanted + (1 << 20) };
    let mut reader = png::Decoder::new_with_limits(Cursor::new(bytes), limits)
        .read_info()
        .map_err(unreadable)?;
    let (width, height) = reader.info().size();
    if (width, height) != (intrinsics.width, intrinsics.height) {
        let advice = format!(
            "must have the {} x {} pixels of the intrinsics, got {width} x {height}",
            intrinsics.width, intrinsics.height
        );
        return Err(FieldError::new(field, advice));
    }
    if reader.output_color_type() != (kind.colour, kind.bits)
        || reader.output_buffer_size() != Some(wanted)
    {
        return Err(FieldError::new(
            field,
            format!("must be a PNG of {}, without palette or alpha", kind.words),
        ));
    }
    let mut pixels = vec![0; wanted];
    reader.next_frame(&mut pixels).map_err(unreadable)?;
    Ok(pixels)
}

#[cfg(test)]
#[path = "decode_tests.rs"]
mod tests;
