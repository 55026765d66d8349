"""Child process that converts one bundle: `python -m capture2vr.edge.convert FOLDER FORMAT KEY OUT`.

A process of its own, because a large mesh takes much memory: it is limited here, and gone afterwards.
"""

from __future__ import annotations

import json
import resource
import sys
from pathlib import Path

from capture2vr.edge.child_process import set_up_child
from capture2vr.edge.convert.convert_bundle import BundleFolder, convert

# Of memory, beside what the libraries take: text has three times the bytes of the arrays that it is made from.
_LEAST_BYTES, _BYTES_PER_BYTE, _MOST_BYTES = 1 << 30, 24, 6 << 30


def main(folder: Path, format_name: str, key: str, out: Path) -> None:
    """Convert the bundle in `folder`, and write the file. A failure ends in a non-zero exit status, with the reason."""
    set_up_child()
    given = sum(path.stat().st_size for path in folder.iterdir())
    limit = min(_LEAST_BYTES + _BYTES_PER_BYTE * given, _MOST_BYTES)
    resource.setrlimit(resource.RLIMIT_DATA, (limit, limit))
    manifest = json.loads((folder / "manifest.json").read_bytes())
    out.write_bytes(convert(BundleFolder(folder, manifest), format_name, key))


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2], sys.argv[3], Path(sys.argv[4]))
