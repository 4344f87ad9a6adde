//! Build script: generates the gRPC code and sets the linker's path to libtorch.

use prost::Message;
use std::error::Error;
use std::path::PathBuf;

fn main() -> Result<(), Box<dyn Error>> {
    let root = PathBuf::from(std::env::var("CARGO_MANIFEST_DIR")?);
    println!("cargo:rerun-if-changed=proto");
    link_libtorch(&root);
    embed_page(&root)?;
    generate_grpc()?;
    generate_sila(&root)
}

/// No LD_LIBRARY_PATH: the program finds libtorch next to itself (a container) or where it was
/// fetched.
fn link_libtorch(root: &std::path::Path) {
    let libtorch =
        std::env::var("LIBTORCH").map(PathBuf::from).unwrap_or_else(|_| root.join(".libtorch"));
    println!("cargo:rerun-if-env-changed=LIBTORCH");
    println!("cargo:rustc-link-arg=-Wl,-rpath,$ORIGIN/lib");
    println!("cargo:rustc-link-arg=-Wl,-rpath,{}", libtorch.join("lib").display());
}

/// The page is built separately from cargo; watching its (git-ignored) folder embeds it again after
/// a rebuild. The folder must exist to be watched: cargo treats a missing path as changed and would
/// rebuild the crate every time.
fn embed_page(root: &std::path::Path) -> Result<(), Box<dyn Error>> {
    std::fs::create_dir_all(root.join("web/dist"))?;
    println!("cargo:rerun-if-changed=web/dist");
    Ok(())
}

/// `flip.v1.rs` for the server and the tests' client, `flip.v1.bin` for reflection. protox is a
/// protobuf compiler in Rust, so protoc need not be installed.
fn generate_grpc() -> Result<(), Box<dyn Error>> {
    let files = protox::compile(["flip/v1/flip.proto"], ["proto"])?;
    let out = PathBuf::from(std::env::var("OUT_DIR")?);
    std::fs::write(out.join("flip.v1.bin"), files.encode_to_vec())?;
    tonic_prost_build::configure().compile_fds(files)?;
    Ok(())
}

/// The features of SiLA 2: `sila.rs` has a module for each package. Their descriptions are in the
/// feature definitions.
fn generate_sila(root: &std::path::Path) -> Result<(), Box<dyn Error>> {
    let folder = root.join("proto/sila");
    let mut protos = Vec::new();
    for entry in std::fs::read_dir(&folder)? {
        let path = entry?.path();
        protos.extend(path.extension().is_some_and(|it| it == "proto").then_some(path.clone()));
    }
    protos.sort();
    let files = protox::compile(protos, [folder])?;
    tonic_prost_build::configure()
        .disable_comments(["."])
        .include_file("sila.rs")
        .compile_fds(files)?;
    Ok(())
}
