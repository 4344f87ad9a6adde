//! The shipped kernels are what the sources give.

use sha2::{Digest, Sha256};
use std::path::Path;
use std::process::Command;

/// With other kernels for spoons or heaps, results stored under the present version are not those of the
/// same inputs any more.
#[test]
fn the_version_is_that_of_these_kernels() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("ptx");
    let known = [
        ("spoons.ptx", "3a7b0ef969a86e19d7d8ed3e7805f74d64f8e13d82f4b182e8849b50e8729313"),
        ("spoons_extended.ptx", "3a1e4592ed85e8176eb54570ec7ad8380aa40e1a736c7e80b5ec3df155ded591"),
        ("heaps.ptx", "64cf359018311d6c0264110a142614863da39b6faf67911416d5a1ca9a6eebb2"),
        ("heaps_extended.ptx", "c2724ccb74ee9004357edf15511762fbe45f99ae84f0904a3e3d69df8a7fa1c3"),
    ];
    for (name, expected) in known {
        let Ok(kernel) = std::fs::read(folder.join(name)) else {
            return println!("skipped: the kernels are not on this machine");
        };
        let found = hex::encode(Sha256::digest(kernel));
        assert_eq!(
            (flip_cuda::VERSION, &*found),
            (5, expected),
            "{name}: raise flip_cuda::VERSION"
        );
    }
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
