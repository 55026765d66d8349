"""From photos to a GLB: `python examples/photos_to_glb.py photos result`.

`photos` is a folder of 15 to 30 photos from all sides of a thing, or of one photo, or any other capture: a video, a
scan of a phone's app, a point cloud. `result` gets lod0.glb, the finest level of detail, coarser ones, and much more.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import capture2vr


def main() -> None:
    """Reconstruct the capture, say how good the mesh is, and write all files."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("capture", type=Path)
    parser.add_argument("result", type=Path)
    parser.add_argument("--preset", default="auto", help="draft: without training; auto: by the capture and the device")
    parser.add_argument("--resolution", type=int, default=0, help="cells along the longest side; 0: by the points")
    asked = parser.parse_args()

    try:
        made = capture2vr.reconstruct(
            asked.capture,
            preset=asked.preset,
            resolution=asked.resolution,
            progress=lambda each: print(f"{each.fraction:4.0%}  {each.stage:<12} {each.message}"),
        )
    except capture2vr.CaptureError as error:
        raise SystemExit(f"{error}: {'; '.join(error.hints)}") from None

    for warning in made.warnings:
        print("warning:", warning)
    share = made.certificate["stray_area"]
    print(f"{len(made.mesh.faces):,} triangles, of which {share:.1%} are where nothing was measured")
    print(made.save(asked.result) / "lod0.glb")


if __name__ == "__main__":
    main()
