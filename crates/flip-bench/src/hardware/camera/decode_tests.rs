use super::super::{Distortion, Frame, Intrinsics, Upload, description};
use flip_core::domain::timestamp::Timestamp;
use serde_json::{Value, json};

const WIDTH: u32 = 80;
const HEIGHT: u32 = 64;

fn frame() -> Frame {
    let intrinsics = Intrinsics {
        width: WIDTH,
        height: HEIGHT,
        fx: 60.0,
        fy: 61.0,
        ppx: 40.5,
        ppy: 31.5,
        model: Distortion::InverseBrownConrady,
        coefficients: [-0.05, 0.06, 0.0, 0.001, 0.0],
    };
    let depth = (0..WIDTH * HEIGHT).map(|k| (k * 7) as u16).collect();
    let colour = (0..WIDTH * HEIGHT).map(|k| [k as u8, 3, 200]).collect();
    Frame {
        intrinsics,
        depth_unit_m: 0.0001,
        depth,
        colour,
        taken_at: Timestamp::from_unix_ms(1_795_248_000_250),
    }
}

fn png(
    width: u32,
    height: u32,
    colour: png::ColorType,
    bits: png::BitDepth,
    pixels: &[u8],
) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, width, height);
    encoder.set_color(colour);
    encoder.set_depth(bits);
    encoder.write_header().unwrap().write_image_data(pixels).unwrap();
    bytes
}

fn upload() -> Upload {
    let frame = frame();
    let depth: Vec<u8> = frame.depth.iter().flat_map(|d| d.to_be_bytes()).collect();
    Upload {
        depth: png(WIDTH, HEIGHT, png::ColorType::Grayscale, png::BitDepth::Sixteen, &depth),
        colour: png(
            WIDTH,
            HEIGHT,
            png::ColorType::Rgb,
            png::BitDepth::Eight,
            frame.colour.as_flattened(),
        ),
        description: description(&frame),
    }
}

#[test]
fn png_and_bare_depth_are_the_same_frame() {
    let mut upload = upload();
    assert_eq!(upload.decode(), Ok(frame()));
    upload.depth = frame().depth.iter().flat_map(|d| d.to_le_bytes()).collect();
    assert_eq!(upload.decode(), Ok(frame()));
    assert!((frame().invalid_share() - 1.0 / f64::from(WIDTH * HEIGHT)).abs() < 1e-12);
}

/// The field that is refused after this change to the description.
fn refused(change: impl FnOnce(&mut Value)) -> String {
    let mut upload = upload();
    let mut said: Value = serde_json::from_slice(&upload.description).unwrap();
    change(&mut said);
    upload.description = said.to_string().into();
    upload.decode().unwrap_err().field
}

#[test]
fn what_a_frame_does_not_say_is_refused_by_field() {
    for part in ["intrinsics", "depth_unit_m", "taken_at"] {
        assert_eq!(refused(|said| drop(said.as_object_mut().unwrap().remove(part))), part);
    }
    for part in ["width", "height", "fx", "fy", "ppx", "ppy", "model", "coefficients"] {
        let gone = refused(|said| drop(said["intrinsics"].as_object_mut().unwrap().remove(part)));
        assert_eq!(gone, format!("intrinsics.{part}"));
    }
}

#[test]
fn what_a_frame_says_wrongly_is_refused_by_field() {
    assert_eq!(refused(|said| said["intrinsics"]["model"] = json!("fisheye")), "intrinsics.model");
    assert_eq!(
        refused(|said| said["intrinsics"]["coefficients"] = json!([0, 0, 0, 0])),
        "intrinsics.coefficients"
    );
    assert_eq!(refused(|said| said["intrinsics"]["width"] = json!(100_000)), "intrinsics.width");
    assert_eq!(refused(|said| said["depth_unit_m"] = json!(0.0)), "depth_unit_m");
    assert_eq!(refused(|said| said["intrinsics"]["width"] = json!(WIDTH + 1)), "depth");
    assert_eq!(refused(|said| said["scale"] = json!(1.0)), "description");
    assert_eq!(refused(|said| *said = json!("x".repeat(5000))), "description");
}

#[test]
fn images_of_another_kind_or_size_are_refused_by_part() {
    use png::{
        BitDepth::{Eight, Sixteen},
        ColorType::{Grayscale, Rgb},
    };
    let pixels = vec![7; 6 * (WIDTH * HEIGHT) as usize];
    let of = |n: u32| &pixels[..(n * WIDTH * HEIGHT) as usize];
    let check = |change: &dyn Fn(&mut Upload), field: &str| {
        let mut upload = upload();
        change(&mut upload);
        assert_eq!(upload.decode().unwrap_err().field, field);
    };
    check(&|u| u.depth = png(WIDTH, HEIGHT, Grayscale, Eight, of(1)), "depth");
    check(&|u| u.depth = png(HEIGHT, WIDTH, Grayscale, Sixteen, of(2)), "depth");
    check(&|u| u.depth.truncate(u.depth.len() / 2), "depth");
    check(&|u| u.depth = vec![0; 2 * (WIDTH * HEIGHT) as usize - 1], "depth");
    check(&|u| u.colour = png(WIDTH, HEIGHT, Grayscale, Eight, of(1)), "colour");
    check(&|u| u.colour = png(WIDTH, HEIGHT, Rgb, Sixteen, of(6)), "colour");
    check(&|u| u.colour = b"GIF89a".to_vec(), "colour");
}

#[test]
fn bytes_cut_or_changed_anywhere_never_panic() {
    let whole = upload();
    for cut in (0..whole.depth.len()).step_by(7) {
        let depth = whole.depth[..cut].to_vec();
        assert!(Upload { depth, ..whole.clone() }.decode().is_err());
    }
    for at in 0..whole.colour.len().min(200) {
        for mask in [0x01, 0x80, 0xff] {
            let mut colour = whole.colour.clone();
            colour[at] ^= mask;
            let _ = Upload { colour, ..whole.clone() }.decode();
        }
    }
    for cut in 0..whole.description.len() {
        let description = whole.description[..cut].to_vec();
        assert!(Upload { description, ..whole.clone() }.decode().is_err());
    }
}
