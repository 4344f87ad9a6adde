//! The shipped kernels are what the sources give.

use sha2::{Digest, Sha256};
use std::path::Path;
use std::process::Command;

/// With other kernels for spoons, results stored under the present version are not those of the same
/// inputs any more.
#[test]
fn the_version_is_that_of_these_kernels() {
    let kernels = Path::new(env!("CARGO_MANIFEST_DIR")).join("ptx/spoons.ptx");
    let Ok(kernels) = std::fs::read(kernels) else {
        return println!("skipped: the kernels are not on this machine");
    };
    let known = (3, "f6b54e73f2caf23a3bc4473f70e3cb9606819cd981ec8532aac503cac10a8bf1");
    let found = hex::encode(Sha256::digest(kernels));
    assert_eq!((flip_cuda::VERSION, found.as_str()), known, "raise flip_cuda::VERSION");
}

/// Runs where `FLIP_NVCC` names a folder with the compiler, as `build_ptx.py` fetches it.
#[test]
fn the_shipped_kernels_are_built_from_the_sources() {
    let folder = std::env::var_os("FLIP_NVCC").filter(|it| Path::new(it).is_dir());
    if folder.is_none() {
        println!("skipped: FLIP_NVCC names no folder with nvcc; see build_ptx.py");
        return;
    }
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("build_ptx.py");
    let status = Command::new("python3").arg(script).arg("--check").status();
    assert!(status.expect("python3 runs").success(), "run crates/flip-cuda/build_ptx.py");
}
