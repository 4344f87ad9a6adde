"""Fetch the CPU libraries of libtorch into .libtorch, once.

tch links against one exact libtorch. PyPI's torch wheel holds it, beside a great deal that FLIP never loads, so
only the libraries and headers below are unpacked (about 490 MB on disk from 540 MB of download). pip checks every
wheel against the SHA-256 in libtorch-requirements.txt before a byte is unpacked.
"""

import pathlib
import shutil
import subprocess
import sys
import tempfile
import zipfile

HERE = pathlib.Path(__file__).resolve().parent
TARGET = HERE.parent / ".libtorch"
REQUIREMENTS = HERE / "libtorch-requirements.txt"
TORCH_VERSION = "2.11.0"
LIBRARIES = {
    "libtorch.so",
    "libtorch_cpu.so",
    "libc10.so",
    "libgomp.so.1",
    "libcudart.so.13",
    "libcupti.so.13",
}
# pip matches the platform tag of a wheel exactly, and the three wheels carry different ones.
PLATFORMS = ["manylinux_2_28_x86_64", "manylinux_2_25_x86_64", "manylinux2014_x86_64", "manylinux_2_17_x86_64"]


def download(folder: pathlib.Path) -> None:
    command = [sys.executable, "-m", "pip", "download", "--no-deps", "--only-binary=:all:", "--require-hashes"]
    command += ["--no-cache-dir", "--disable-pip-version-check", "--python-version", "3.11", "--implementation", "cp"]
    for platform in PLATFORMS:
        command += ["--platform", platform]
    command += ["-r", str(REQUIREMENTS), "-d", str(folder)]
    subprocess.run(command, check=True)


def unpack(wheels: pathlib.Path, target: pathlib.Path) -> None:
    (target / "lib").mkdir(parents=True)
    found = set()
    for wheel in sorted(wheels.glob("*.whl")):
        with zipfile.ZipFile(wheel) as archive:
            for member in archive.namelist():
                name = pathlib.PurePosixPath(member)
                if name.name in LIBRARIES:
                    destination = target / "lib" / name.name
                    found.add(name.name)
                elif member.startswith("torch/include/") and not member.endswith("/"):
                    destination = target / "include" / name.relative_to("torch/include")
                else:
                    continue
                destination.parent.mkdir(parents=True, exist_ok=True)
                with archive.open(member) as source, open(destination, "wb") as sink:
                    shutil.copyfileobj(source, sink, 1 << 20)
    missing = LIBRARIES - found
    if missing:
        raise SystemExit(f"libtorch: the wheels lack {sorted(missing)}")


def main() -> None:
    stamp = TARGET / "build-version"
    if stamp.exists() and stamp.read_text().strip() == TORCH_VERSION:
        return
    print(f"libtorch: fetching torch {TORCH_VERSION} (CPU libraries, 540 MB, once)", file=sys.stderr)
    with tempfile.TemporaryDirectory(dir=HERE.parent, prefix=".libtorch-") as work:
        wheels, target = pathlib.Path(work) / "wheels", pathlib.Path(work) / "libtorch"
        wheels.mkdir()
        download(wheels)
        unpack(wheels, target)
        # The stamp is written last and the folder moved into place whole: an interrupted fetch starts again.
        (target / "build-version").write_text(TORCH_VERSION + "\n")
        if TARGET.exists():
            shutil.rmtree(TARGET)
        target.rename(TARGET)
    print("libtorch: ready", file=sys.stderr)


if __name__ == "__main__":
    main()
