"""Generate the gRPC Python code from proto/ into services/edge/api; with --check, fail if the code there is stale.

    python proto/generate.py            write the files
    python proto/generate.py --check    exit 1 and name the stale files

protoc names modules after the folders of the .proto file (`capture2vr.edge.v1.edge_pb2`); here they live in the import
package `services`, so the one import between them is rewritten.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from importlib.metadata import version
from pathlib import Path

PROTO_ROOT = Path(__file__).resolve().parent
PROTO_FILE = "capture2vr/edge/v1/edge.proto"
API = PROTO_ROOT.parent / "services" / "edge" / "api"
NAMES = ("edge_pb2.py", "edge_pb2.pyi", "edge_pb2_grpc.py")

TOOLS_VERSION = "1.85.1"
"""Version of grpcio-tools that made the checked-in code, as in pyproject.toml; another one writes other bytes."""

IMPORTS = {"from capture2vr.edge.v1 import": "from capture2vr.edge.api import"}


class WrongToolsError(RuntimeError):
    """The installed grpcio-tools is not the pinned one, so its output cannot be compared."""


def generate() -> dict[str, bytes]:
    """Generate the files' contents from the .proto, by file name.

    Raises WrongToolsError, or RuntimeError when protoc refuses the file.
    """
    from grpc_tools import protoc

    if (installed := version("grpcio-tools")) != TOOLS_VERSION:
        raise WrongToolsError(f"grpcio-tools {installed} is installed, version {TOOLS_VERSION} is needed")
    with tempfile.TemporaryDirectory() as folder:
        outputs = [f"--{kind}_out={folder}" for kind in ("python", "pyi", "grpc_python")]
        if protoc.main(["protoc", f"-I{PROTO_ROOT}", *outputs, PROTO_FILE]) != 0:
            raise RuntimeError(f"protoc refused {PROTO_FILE}")
        made = Path(folder, PROTO_FILE).parent
        return {name: _rewrite_imports((made / name).read_text("utf-8")) for name in NAMES}


def stale() -> list[str]:
    """List the checked-in files that differ from what the .proto generates."""
    return [name for name, content in generate().items() if not _has_content(API / name, content)]


def _rewrite_imports(text: str) -> bytes:
    for theirs, ours in IMPORTS.items():
        text = text.replace(theirs, ours)
    return text.encode()


def _has_content(path: Path, content: bytes) -> bool:
    return path.is_file() and path.read_bytes() == content


def main() -> int:
    parser = argparse.ArgumentParser(description="Generate services/edge/api from the wire's .proto file.")
    parser.add_argument("--check", action="store_true", help="write nothing; fail when the checked-in code is stale")
    if parser.parse_args().check:
        names = stale()
        for name in names:
            sys.stderr.write(f"stale: services/edge/api/{name}; run python proto/generate.py\n")
        return 1 if names else 0
    for name, content in generate().items():
        (API / name).write_bytes(content)
    return 0


if __name__ == "__main__":
    sys.exit(main())
