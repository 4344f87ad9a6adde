"""Builds the wheel: `python3 python/build.py [--out FOLDER]` (default target/wheels).

Generates `flip_powder/api` from web/openapi.json, then runs maturin. Both tools are installed, pinned, into a virtual
environment of their own below target/; cargo and Rust are those of the repository. Prints the wheel's path and size.
"""

import argparse
import os
import pathlib
import shutil
import subprocess
import sys

ROOT = pathlib.Path(__file__).resolve().parent.parent
PYTHON = ROOT / "python"
TARGET = pathlib.Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target"))
TOOLS = ["maturin==1.16.0", "openapi-python-client==0.29.1", "ruff==0.17.6"]


def tools() -> pathlib.Path:
    """The folder of the tools' programs; made once."""
    folder = TARGET / "python-tools"
    has = folder / "packages.txt"
    if not has.exists() or has.read_text() != "\n".join(TOOLS):
        shutil.rmtree(folder, ignore_errors=True)
        subprocess.run([sys.executable, "-m", "venv", str(folder)], check=True)
        pip = [str(folder / "bin/python"), "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
        subprocess.run([*pip, *TOOLS], check=True)
        has.write_text("\n".join(TOOLS))
    return folder / "bin"


def generate(programs: pathlib.Path) -> str:
    """Writes `flip_powder/api`; what the generator complains of."""
    document, folder = ROOT / "web/openapi.json", PYTHON / "flip_powder/api"
    command = [programs / "openapi-python-client", "generate", "--path", document, "--output-path", folder]
    command += ["--meta", "none", "--overwrite", "--config", PYTHON / "api.yaml"]
    path = f"{programs}:{os.environ['PATH']}"
    done = subprocess.run(
        [str(it) for it in command], check=True, capture_output=True, text=True, env={**os.environ, "PATH": path}
    )
    return "\n".join(line for line in (done.stdout + done.stderr).splitlines() if line.startswith("WARNING"))


def build(programs: pathlib.Path, out: pathlib.Path) -> pathlib.Path:
    """Builds the wheel."""
    out.mkdir(parents=True, exist_ok=True)
    for old in out.glob("flip_powder-*.whl"):
        old.unlink()
    command = [programs / "maturin", "build", "--release", "--locked", "--out", out, "--quiet"]
    subprocess.run([str(it) for it in command], check=True, cwd=PYTHON)
    (wheel,) = out.glob("flip_powder-*.whl")
    return wheel


def main() -> None:
    """Builds and says what was built."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=pathlib.Path, default=TARGET / "wheels")
    out = parser.parse_args().out.resolve()
    programs = tools()
    complaints = generate(programs)
    if complaints:
        print(complaints, file=sys.stderr)
    wheel = build(programs, out)
    print(f"{wheel} {wheel.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
