//! Uploaded camera frames. An input is a description, a line feed, the depth, eight bytes
//! `\n--cut--` and the colour.

use crate::engine::{Seen, Target, bounded, outcome};
use flip_bench::emulate::camera::upload;
use flip_bench::hardware::camera::{Frame, SIDE_MAX, SIDE_MIN, Upload};

/// Separator between depth and colour.
const CUT: &[u8] = b"\n--cut--";
/// Signature at the start of a PNG.
const SIGNATURE: &[u8] = b"\x89PNG\r\n\x1a\n";
const WORDS: &[&str] = &[
    "\"width\":",
    "\"height\":",
    "\"fx\":",
    "\"ppx\":",
    "\"model\":\"none\"",
    "\"brown_conrady\"",
    "\"coefficients\":",
    "\"depth_unit_m\":",
    "\"taken_at\":",
    "null",
    "1e999",
    "-1e-320",
    "9999-12-31T23:59:59.9999Z",
    "0000-01-01T00:00:00Z",
    "2048",
    "64",
    "[[[[[[[[",
    "{\"a\":",
    "IHDR",
    "IDAT",
    "IEND",
    "PLTE",
    "tRNS",
    "acTL",
    "fdAT",
    "zTXt",
    "iCCP",
];

pub const FRAME: Target = Target {
    name: "camera_frame",
    check: check_frame,
    repair: Some(repair),
    words: WORDS,
    bytes_max: 64 << 10,
};

fn check_frame(input: &[u8]) -> Result<Seen, String> {
    let upload = parts(input);
    let frame = match bounded(bytes_max(&upload), || upload.decode())? {
        Ok(frame) => frame,
        Err(error) if error.message.is_empty() => return Err("a refusal without words".to_owned()),
        Err(error) => return Ok(Seen::Refused(outcome(kind(&error.field, &error.message)))),
    };
    let lens = &frame.intrinsics;
    let sides = SIDE_MIN..=SIDE_MAX;
    if !sides.contains(&lens.width) || !sides.contains(&lens.height) {
        return Err(format!("a frame of {} x {} pixels", lens.width, lens.height));
    }
    if (frame.depth.len(), frame.colour.len()) != (lens.pixels(), lens.pixels()) {
        return Err(format!(
            "{} pixels, but {} depths and {} colours",
            lens.pixels(),
            frame.depth.len(),
            frame.colour.len()
        ));
    }
    if !(frame.unit_mm() > 0.0
        && frame.unit_mm() <= 10.0
        && (0.0..=1.0).contains(&frame.invalid_share()))
    {
        return Err(format!("steps of {} mm", frame.unit_mm()));
    }
    let point = lens.deproject([f64::from(lens.width - 1), 0.0], 200.0);
    if !point.iter().all(|length| length.is_finite()) {
        return Err(format!("a corner lies at {point:?}"));
    }
    check_written(&frame)?;
    Ok(Seen::Read(outcome((
        lens.width,
        lens.height,
        lens.model.name(),
        upload.depth.starts_with(SIGNATURE),
    ))))
}

/// Checks that uploading it again, as a PNG and as bare values, returns the same frame.
fn check_written(frame: &Frame) -> Result<(), String> {
    let mut again = upload(frame).map_err(|error| error.to_string())?;
    let from_png = again.decode();
    again.depth = frame.depth.iter().flat_map(|depth| depth.to_le_bytes()).collect();
    if from_png.as_ref() != Ok(frame) || again.decode().as_ref() != Ok(frame) {
        let said = String::from_utf8_lossy(&again.description).into_owned();
        return Err(format!("uploaded again it is another frame: {said}, {:?}", from_png.err()));
    }
    Ok(())
}

/// Two images of the size the description allows, with room for the decoder; a refused description
/// leaves no more than a few kilobytes.
fn bytes_max(upload: &Upload) -> usize {
    let pixels =
        serde_json::from_slice::<serde_json::Value>(&upload.description).ok().and_then(|said| {
            let side = |name: &str| {
                said["intrinsics"][name].as_u64().filter(|side| *side <= u64::from(SIDE_MAX))
            };
            Some(side("width")? * side("height")?)
        });
    let images =
        pixels.map_or(0, |pixels| usize::try_from(pixels).expect("two sides") * 8 + (2 << 20));
    images
        + 16 * upload.description.len()
        + 2 * upload.depth.len()
        + 2 * upload.colour.len()
        + (64 << 10)
}

fn parts(input: &[u8]) -> Upload {
    let (description, rest) = split(input, b"\n");
    let (depth, colour) = split(rest, CUT);
    Upload { depth: depth.to_vec(), colour: colour.to_vec(), description: description.to_vec() }
}

fn split<'a>(bytes: &'a [u8], at: &[u8]) -> (&'a [u8], &'a [u8]) {
    let end = bytes.windows(at.len()).position(|window| window == at);
    end.map_or((bytes, &[]), |end| (&bytes[..end], &bytes[end + at.len()..]))
}

/// Field and first words of a refusal, without its numbers.
fn kind(field: &str, message: &str) -> (String, String) {
    (field.to_owned(), message.chars().filter(|c| c.is_ascii_alphabetic()).take(40).collect())
}

/// Corrects the checksums of the PNGs' chunks. Lengths stay as they are; anything beyond the image
/// is left alone.
fn repair(mut input: Vec<u8>) -> Vec<u8> {
    let starts: Vec<usize> =
        (0..input.len()).filter(|at| input[*at..].starts_with(SIGNATURE)).collect();
    for start in starts {
        let mut at = start + SIGNATURE.len();
        while let Some(end) = chunk_end(&input, at) {
            let sum = crc32(&input[at + 4..end]);
            input[end..end + 4].copy_from_slice(&sum.to_be_bytes());
            at = end + 4;
        }
    }
    input
}

/// End of the data of the chunk at `at`, if its checksum still lies within the input.
fn chunk_end(input: &[u8], at: usize) -> Option<usize> {
    let length = u32::from_be_bytes(*input.get(at..)?.first_chunk()?);
    let end = at.checked_add(8)?.checked_add(usize::try_from(length).ok()?)?;
    (end.checked_add(4)? <= input.len()).then_some(end)
}

/// The checksum of PNG.
fn crc32(bytes: &[u8]) -> u32 {
    let shift = |sum: u32, _| if sum & 1 == 1 { sum >> 1 ^ 0xEDB8_8320 } else { sum >> 1 };
    !bytes.iter().fold(u32::MAX, |sum, byte| (0..8).fold(sum ^ u32::from(*byte), shift))
}
