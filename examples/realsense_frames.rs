//! A RealSense camera for measurements of the angle of repose: waits for a pile, takes its frames,
//! uploads them.
//!
//! It has been compiled and never run with a camera; it was written for a D405. It needs
//! librealsense 2.56 or newer.
//!
//! ```text
//! cargo run --release --features realsense --example realsense_frames -- http://127.0.0.1:8080 <id of the measurement>
//! ```
//!
//! If the server requires a token, it is read from `FLIP_TOKEN` (role operator). Depth and colour
//! come from one imager on a D405, pixel on pixel, so nothing is aligned; a camera whose two
//! streams differ in their lens is refused, because depth would be read where colour is not. Every
//! frame carries its own lens, distortion, unit of depth and time, as the service demands.

use anyhow::{Context as _, bail, ensure};
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use flip_bench::emulate::camera::upload;
use flip_bench::hardware::camera::{Distortion, Frame, Intrinsics};
use flip_core::domain::timestamp::Timestamp;
use realsense_rust::config::Config;
use realsense_rust::context::Context;
use realsense_rust::frame::{ColorFrame, CompositeFrame, DepthFrame, FrameEx, PixelKind};
use realsense_rust::kind::{Rs2DistortionModel, Rs2Format, Rs2StreamKind};
use realsense_rust::pipeline::{ActivePipeline, InactivePipeline};
use reqwest::{Client, StatusCode};
use serde_json::{Value, json};
use std::time::Duration;

/// Size and rate of both streams: the D405's most exact depth.
const SIZE: [usize; 2] = [1280, 720];
const PER_SECOND: usize = 5;
/// Frames discarded before the first is kept: exposure has to settle.
const SETTLING: usize = 10;
/// Time between two polls of the measurement.
const LOOK: Duration = Duration::from_millis(500);
/// Longest wait for a frame.
const FRAME: Duration = Duration::from_secs(5);

#[tokio::main(flavor = "current_thread")]
async fn main() -> anyhow::Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [server, measurement] = arguments.as_slice() else {
        bail!("usage: realsense_frames <address of the server> <id of the measurement>");
    };
    let service = Service {
        client: Client::new(),
        measurement: format!("{server}/v1/repose-measurements/{measurement}"),
        token: std::env::var("FLIP_TOKEN").ok(),
    };
    let mut camera = started()?;
    for _ in 0..SETTLING {
        camera.wait(Some(FRAME))?;
    }
    loop {
        let found = service.found().await?;
        if !["queued", "running"]
            .contains(&found["job"]["state"].as_str().context("a job has a state")?)
        {
            println!("the measurement has ended: {}", found["job"]["state"]);
            return Ok(());
        }
        if found["awaits"].is_null() {
            tokio::time::sleep(LOOK).await;
            continue;
        }
        // The first may have waited in the queue since before the pile rested.
        camera.wait(Some(FRAME))?;
        service.add(&taken(&camera.wait(Some(FRAME))?)?).await?;
    }
}

/// Starts depth and colour on the first camera found.
fn started() -> anyhow::Result<ActivePipeline> {
    let context = Context::new()?;
    let [width, height] = SIZE;
    let mut config = Config::new();
    config.enable_stream(Rs2StreamKind::Depth, None, width, height, Rs2Format::Z16, PER_SECOND)?;
    config.enable_stream(Rs2StreamKind::Color, None, width, height, Rs2Format::Rgb8, PER_SECOND)?;
    InactivePipeline::try_from(&context)?
        .start(Some(config))
        .context("no camera with depth and colour of this size")
}

/// One frame in the format of the service.
fn taken(frames: &CompositeFrame) -> anyhow::Result<Frame> {
    let depth = frames.frames_of_type::<DepthFrame>().pop().context("no depth")?;
    let colour = frames.frames_of_type::<ColorFrame>().pop().context("no colour")?;
    let intrinsics = lens(&depth)?;
    ensure!(
        intrinsics == lens(&colour)?,
        "depth and colour have different lenses: only cameras like the D405 are served"
    );
    let steps = depth.iter().map(|pixel| match pixel {
        PixelKind::Z16 { depth } => Ok(*depth),
        other => bail!("depth is {other:?}, not Z16"),
    });
    let pixels = colour.iter().map(|pixel| match pixel {
        PixelKind::Rgb8 { r, g, b } => Ok([*r, *g, *b]),
        other => bail!("colour is {other:?}, not RGB8"),
    });
    Ok(Frame {
        intrinsics,
        // By its decimal digits: as an f32 it is 1e-4, widened it would be 9.9999997e-5.
        depth_unit_m: format!("{}", depth.depth_units()?).parse()?,
        depth: steps.collect::<anyhow::Result<_>>()?,
        colour: pixels.collect::<anyhow::Result<_>>()?,
        taken_at: now()?,
    })
}

/// By this machine's clock: a camera's own counts from when it was plugged in.
fn now() -> anyhow::Result<Timestamp> {
    let since_1970 = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH)?;
    Ok(Timestamp::from_unix_ms(since_1970.as_millis().try_into()?))
}

fn lens<F: FrameEx>(frame: &F) -> anyhow::Result<Intrinsics> {
    let lens = frame.stream_profile().intrinsics()?;
    let distortion = lens.distortion();
    let model = match distortion.model {
        Rs2DistortionModel::None => Distortion::None,
        Rs2DistortionModel::BrownConrady => Distortion::BrownConrady,
        Rs2DistortionModel::BrownConradyInverse => Distortion::InverseBrownConrady,
        Rs2DistortionModel::BrownConradyModified => Distortion::ModifiedBrownConrady,
        other => bail!("the lens distorts as {other:?}, which piles are not measured with"),
    };
    Ok(Intrinsics {
        width: lens.width().try_into()?,
        height: lens.height().try_into()?,
        fx: lens.fx().into(),
        fy: lens.fy().into(),
        ppx: lens.ppx().into(),
        ppy: lens.ppy().into(),
        model,
        coefficients: distortion.coeffs.map(f64::from),
    })
}

/// The measurement on the server.
struct Service {
    client: Client,
    measurement: String,
    token: Option<String>,
}

impl Service {
    fn request(&self, post: bool, place: &str) -> reqwest::RequestBuilder {
        let request = if post { self.client.post(place) } else { self.client.get(place) };
        match &self.token {
            Some(token) => request.bearer_auth(token),
            None => request,
        }
    }

    async fn found(&self) -> anyhow::Result<Value> {
        let response = self.request(false, &self.measurement).send().await?;
        let status = response.status();
        let text = response.text().await?;
        ensure!(status == StatusCode::OK, "{}: {status}: {text}", self.measurement);
        Ok(serde_json::from_str(&text)?)
    }

    async fn add(&self, frame: &Frame) -> anyhow::Result<()> {
        let bytes = upload(frame)?;
        let [depth, colour] = [&bytes.depth, &bytes.colour].map(|part| STANDARD.encode(part));
        let description: Value = serde_json::from_slice(&bytes.description)?;
        let body = json!({ "depth": depth, "colour": colour, "description": description });
        let response =
            self.request(true, &format!("{}/frames", self.measurement)).json(&body).send().await?;
        match response.status() {
            // In a conflict the pile received all its frames in the meantime.
            StatusCode::ACCEPTED | StatusCode::CONFLICT => Ok(()),
            status => bail!("the frame was refused: {status}: {}", response.text().await?),
        }
    }
}
