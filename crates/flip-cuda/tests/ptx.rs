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
        ("spoons.ptx", "ad525b44b3c0ef57519300035b81aa00e7424f7703db2b4273b313b2d4408de9"),
        ("spoons_extended.ptx", "e4d33b170ce788ba74240990a98720c56361f2b1128ad311aed711bbeee99203"),
        ("heaps.ptx", "6d070a855754f5285e87f1fc3af8ce8b732fb0bc8049c38aa826abc37a9e7318"),
        ("heaps_extended.ptx", "52ef3796e008829f6321043bcdf75249792ff3e9d87be7daf0c8114635904b59"),
    ];
    for (name, expected) in known {
        let Ok(kernel) = std::fs::read(folder.join(name)) else {
            return println!("skipped: the kernels are not on this machine");
        };
        let found = hex::encode(Sha256::digest(kernel));
        assert_eq!(
            (flip_cuda::VERSION, &*found),
            (4, expected),
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
