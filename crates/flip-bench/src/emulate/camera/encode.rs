//! Frames as a camera's host would upload them.

use crate::hardware::camera::{Frame, Upload, description};

/// The three parts of an upload that decodes to this frame.
///
/// # Errors
/// The encoder refuses (a frame whose sides do not fit its pixels).
pub fn upload(frame: &Frame) -> Result<Upload, png::EncodingError> {
    let size = (frame.intrinsics.width, frame.intrinsics.height);
    let depth: Vec<u8> = frame.depth.iter().flat_map(|depth| depth.to_be_bytes()).collect();
    let grey = (png::ColorType::Grayscale, png::BitDepth::Sixteen);
    let rgb = (png::ColorType::Rgb, png::BitDepth::Eight);
    Ok(Upload {
        depth: png(size, grey, &depth)?,
        colour: png(size, rgb, frame.colour.as_flattened())?,
        description: description(frame),
    })
}

fn png(
    (width, height): (u32, u32),
    (colour, bits): (png::ColorType, png::BitDepth),
    pixels: &[u8],
) -> Result<Vec<u8>, png::EncodingError> {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, width, height);
    encoder.set_color(colour);
    encoder.set_depth(bits);
    encoder.set_compression(png::Compression::Fast);
    let mut writer = encoder.write_header()?;
    writer.write_image_data(pixels)?;
    writer.finish()?;
    Ok(bytes)
}
