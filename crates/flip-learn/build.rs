//! Build script: tells the linker of tests where libtorch lies.

use std::path::{Path, PathBuf};

fn main() {
    println!("cargo:rerun-if-env-changed=LIBTORCH");
    let fetched = || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../.libtorch");
    let libtorch = std::env::var("LIBTORCH").map(PathBuf::from).unwrap_or_else(|_| fetched());
    println!("cargo:rustc-link-arg=-Wl,-rpath,{}", libtorch.join("lib").display());
}
