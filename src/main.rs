//! The `flip` binary: `flip --help` lists its commands.

fn main() -> std::process::ExitCode {
    flip::cli::main()
}
