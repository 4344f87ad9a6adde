"""The OpenAPI document, read by the generators that others use: none may find anything to warn of."""

import json
import pathlib
import subprocess
import sys
import tempfile
import unittest

from service import ROOT, environment, skip

sys.path.insert(0, str(ROOT / "python"))

from build import TOOLS  # noqa: E402

DOCUMENT = ROOT / "web/openapi.json"
# The pins are those of the wheel's build; ruff formats what is generated.
GENERATOR = ("openapi", *(tool for tool in TOOLS if not tool.startswith("maturin")))
METHODS = ("get", "put", "post", "patch", "delete")
WEB = ROOT / "web/node_modules/.bin"


def run(*command, path=""):
    where = {"PATH": f"{path}:/usr/bin:/bin:/usr/local/bin", "HOME": tempfile.gettempdir(), "NO_COLOR": "1"}
    done = subprocess.run([str(it) for it in command], capture_output=True, text=True, timeout=300, env=where)
    return done.returncode, (done.stdout + done.stderr).strip()


class Document(unittest.TestCase):
    maxDiff = None

    def test_openapi_python_client_makes_every_operation_without_a_warning(self):
        programs = pathlib.Path(environment(*GENERATOR)).parent
        with tempfile.TemporaryDirectory() as folder:
            made = pathlib.Path(folder, "api")
            # Its default settings: what anybody gets who runs it.
            command = [programs / "openapi-python-client", "generate", "--path", DOCUMENT, "--output-path", made, "--meta", "none"]
            status, said = run(*command, "--fail-on-warning", path=programs)
            self.assertEqual((status, said), (0, f"Generating {made}"))
            compiled = subprocess.run([sys.executable, "-m", "compileall", "-q", str(made)], capture_output=True, text=True)
            self.assertEqual(compiled.returncode, 0, compiled.stdout)
            files = [file for file in made.glob("api/*/*.py") if file.stem != "__init__"]
        self.assertEqual(len(files), operations())

    def test_openapi_typescript_makes_types_that_compile_without_a_warning(self):
        if not (WEB / "openapi-typescript").exists():
            skip("web/node_modules is missing: make web")
        with tempfile.TemporaryDirectory() as folder:
            made = pathlib.Path(folder, "schema.d.ts")
            status, said = run(WEB / "openapi-typescript", DOCUMENT, "--output", made)
            self.assertEqual(status, 0, said)
            # Its own name, and what it wrote in how long.
            self.assertEqual([line for line in said.splitlines() if not line.startswith(("✨", "🚀"))], [])
            self.assertEqual(run(WEB / "tsc", "--noEmit", "--strict", "--skipLibCheck", "false", made), (0, ""))


def operations():
    paths = json.loads(DOCUMENT.read_text())["paths"].values()
    return sum(method in path for path in paths for method in METHODS)


if __name__ == "__main__":
    unittest.main()
