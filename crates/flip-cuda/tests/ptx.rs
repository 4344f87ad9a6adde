//! The shipped kernels are what the sources give.

use std::path::Path;
use std::process::Command;

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
