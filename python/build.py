"""Builds the wheel: `python3 python/build.py [--out FOLDER] [--target TRIPLE]` (default: target/wheels, this machine).

Generates `flip_powder/api` from web/openapi.json, then runs maturin. Both tools are installed, pinned, into a virtual
environment of their own below target/; cargo and Rust are those of the repository. For another machine, such as
aarch64-unknown-linux-gnu, zig links the wheel; `rustup target add` fetches what Rust needs for it. Prints the wheel's
path and size.
"""

import argparse
import os
import pathlib
import platform
import shutil
import subprocess
import sys

HERE = pathlib.Path(__file__).resolve()
ROOT = HERE.parent.parent
PYTHON = ROOT / "python"
TARGET = pathlib.Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target"))
TOOLS = ["maturin==1.16.0", "openapi-python-client==0.29.1", "ruff==0.17.6"]
ZIG = "ziglang==0.17.1"


def tools(packages: list[str]) -> pathlib.Path:
    """The folder of the tools' programs; made once."""
    folder = TARGET / "python-tools"
    has = folder / "packages.txt"
    if not has.exists() or not set(packages) <= set(has.read_text().splitlines()):
        shutil.rmtree(folder, ignore_errors=True)
        subprocess.run([sys.executable, "-m", "venv", str(folder)], check=True)
        pip = [str(folder / "bin/python"), "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
        subprocess.run([*pip, *packages], check=True)
        has.write_text("\n".join(packages))
    return folder / "bin"


def generate(programs: pathlib.Path) -> str:
    """Writes `flip_powder/api` unless it is of the same document; what the generator complains of."""
    document, config, folder = ROOT / "web/openapi.json", PYTHON / "api.yaml", PYTHON / "flip_powder/api"
    # What is complete has the time of what it was made from; what was interrupted has its own.
    changed, made = max(it.stat().st_mtime_ns for it in (document, config, HERE)), folder / "__init__.py"
    if made.exists() and made.stat().st_mtime_ns == changed:
        return ""
    command = [programs / "openapi-python-client", "generate", "--path", document, "--output-path", folder]
    command += ["--meta", "none", "--overwrite", "--config", config]
    path = f"{programs}:{os.environ['PATH']}"
    done = subprocess.run(
        [str(it) for it in command], check=True, capture_output=True, text=True, env={**os.environ, "PATH": path}
    )
    os.utime(made, ns=(changed, changed))
    return "\n".join(line for line in (done.stdout + done.stderr).splitlines() if line.startswith("WARNING"))


def build(
    programs: pathlib.Path, out: pathlib.Path, target: str | None = None, profile: str = "release"
) -> pathlib.Path:
    """Builds the wheel."""
    # Wheels for different machines may lie beside each other.
    names = f"flip_powder-*_{(target or platform.machine()).partition('-')[0]}.whl"
    out.mkdir(parents=True, exist_ok=True)
    for old in out.glob(names):
        old.unlink()
    command = [programs / "maturin", "build", "--profile", profile, "--locked", "--out", out, "--quiet"]
    if target:
        command += ["--target", target, "--zig"]
    # maturin looks for the zig of the first Python on the path.
    path = f"{programs}:{os.environ['PATH']}"
    subprocess.run([str(it) for it in command], check=True, cwd=PYTHON, env={**os.environ, "PATH": path})
    (wheel,) = out.glob(names)
    return wheel


def main() -> None:
    """Builds and says what was built."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=pathlib.Path, default=TARGET / "wheels")
    parser.add_argument("--target", help="Rust's name of the machine that the wheel is for")
    asked = parser.parse_args()
    programs = tools([*TOOLS, ZIG] if asked.target else TOOLS)
    complaints = generate(programs)
    if complaints:
        print(complaints, file=sys.stderr)
    wheel = build(programs, asked.out.resolve(), asked.target)
    print(f"{wheel} {wheel.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
