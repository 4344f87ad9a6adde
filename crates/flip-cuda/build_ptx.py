#!/usr/bin/env python3
"""Build the kernels in ptx/ from cuda/ with nvcc from PyPI.

    python3 crates/flip-cuda/build_ptx.py            # build
    python3 crates/flip-cuda/build_ptx.py --check    # build elsewhere and compare

The compiler is fetched by pip, with the versions and hashes of ptx/requirements.txt, into the
folder $FLIP_NVCC, or a temporary one. No graphics card and no driver are needed.
"""

import os
import pathlib
import subprocess
import sys
import tempfile

HERE = pathlib.Path(__file__).resolve().parent
# The oldest cards that the kernels serve; newer ones compile the same text for themselves.
COMMON = ["-ptx", "-arch=compute_80", "--std=c++17", "-O3"]
BUILDS = {
    "spoons.ptx": ["-ftz=true", "spoons.cu"],
    "spoons_extended.ptx": ["-ftz=true", "-DFLIP_EXTENDED", "spoons.cu"],
    "heaps.ptx": ["-ftz=true", "-DFLIP_HEAPS", "spoons.cu"],
    "heaps_extended.ptx": ["-ftz=true", "-DFLIP_HEAPS", "-DFLIP_EXTENDED", "spoons.cu"],
    "spoons_exact.ptx": ["-fmad=false", "-DFLIP_EXACT", "spoons.cu"],
    # Fused where the source says so, as on a processor.
    "learner.ptx": ["-fmad=false", "learner.cu"],
}


def compiler(folder: pathlib.Path) -> pathlib.Path:
    """Return nvcc in the folder, fetched if it is not there."""
    nvcc = folder / "nvidia/cu13/bin/nvcc"
    if not nvcc.exists():
        fetch = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--require-hashes",
                 "--only-binary=:all:", "--no-compile", "--target", str(folder),
                 "-r", str(HERE / "ptx/requirements.txt")]
        subprocess.run(fetch, check=True)
    return nvcc


def build(nvcc: pathlib.Path, into: pathlib.Path) -> None:
    """Compile every kernel into a folder."""
    for name, flags in BUILDS.items():
        command = [str(nvcc), *COMMON, *flags, "-o", str(into / name)]
        subprocess.run(command, check=True, cwd=HERE / "cuda")


def main() -> int:
    """Build, or compare with what is there; return 1 if they differ."""
    shipped = HERE / "ptx"
    with tempfile.TemporaryDirectory() as temporary:
        nvcc = compiler(pathlib.Path(os.environ.get("FLIP_NVCC", temporary)))
        if "--check" not in sys.argv[1:]:
            build(nvcc, shipped)
            return 0
        with tempfile.TemporaryDirectory() as fresh:
            build(nvcc, pathlib.Path(fresh))
            different = [name for name in BUILDS
                         if (pathlib.Path(fresh) / name).read_bytes() != (shipped / name).read_bytes()]
    for name in different:
        print(f"ptx/{name} is not what cuda/ gives: run crates/flip-cuda/build_ptx.py")
    return 1 if different else 0


if __name__ == "__main__":
    sys.exit(main())
