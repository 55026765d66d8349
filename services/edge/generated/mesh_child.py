"""Child process that reads one GLB: `python -m capture2vr.edge.generated.mesh_child FILE FOLDER BYTES`.

It writes points on the surface and their colours to FOLDER, or why there are none, with at most BYTES of address space.
"""

from __future__ import annotations

import json
import resource
import sys
from pathlib import Path

import numpy as np

from capture2vr.edge.capture.files import Folder, translate_errors
from capture2vr.edge.child_process import set_up_child
from capture2vr.edge.clouds.cloud import read_cloud
from capture2vr.edge.errors import CaptureError
from capture2vr.edge.generated.read_mesh import COLOURS, FAILURE, POSITIONS
from capture2vr.sentences.documents import with_codes


def main(file: Path, folder: Path, limit_bytes: int) -> None:
    """Read `file` into `folder`; a file that is at fault is told there, every other failure is a non-zero exit."""
    resource.setrlimit(resource.RLIMIT_AS, (limit_bytes, limit_bytes))
    try:
        with np.errstate(all="ignore"), translate_errors(file.name, "GLB"):
            cloud = read_cloud(Folder(file.parent, (file.name,)), file.name, "glb").cloud
    except CaptureError as error:
        (folder / FAILURE).write_text(json.dumps(with_codes({"why": error.message})))
        return
    assert cloud is not None
    np.save(folder / POSITIONS, cloud.xyz)
    if cloud.rgb is not None:
        np.save(folder / COLOURS, cloud.rgb)


if __name__ == "__main__":
    set_up_child()
    main(Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3]))
