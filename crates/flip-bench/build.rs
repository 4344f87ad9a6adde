//! Build script: generates what the driver of an arm offers.

use std::error::Error;
use std::path::Path;

/// FLIP is its client, and no reflection shows it. protox is a protobuf compiler in Rust, so no protoc has to be installed.
fn main() -> Result<(), Box<dyn Error>> {
    let proto = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../proto");
    println!("cargo:rerun-if-changed={}", proto.join("flip/bench/v1/arm.proto").display());
    let arm = protox::compile(["flip/bench/v1/arm.proto"], [proto])?;
    tonic_prost_build::configure().compile_fds(arm)?;
    Ok(())
}
