"""Photos rendered of what is hard to capture, made to assets, beside the surface that the photos show.

Each subject in a process of its own, preset `draft`, on the CPU, cameras given. One photo in eight is held out.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from pathlib import Path
from typing import Any

from capture2vr.edge.export.ply import ply_bytes
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.read_capture import read_capture
from tests.bench.captures import (
    Row,
    closing_figures,
    filled_vertices,
    full_mesh,
    make,
    photo_figures,
    print_rows,
    slug,
    write_pictures,
)
from tests.bench.photo_sets import rendered
from tests.bench.rendered_figures import Comparison, depth_by_luma, to_truth
from tests.bench.seam import seam_figures
from tests.support.photos.rendered.photos import SUBJECTS


def write(name: str, folder: Path) -> None:
    """Write a subject's photos with their cameras, and its surface as `truth.ply` in the cameras' frame."""
    known, _ = rendered(name, folder)
    assert known.truth is not None
    known.truth.export(folder / "truth.ply")


def one(name: str, out: Path | None = None, photos: Path | None = None) -> dict[str, Any]:
    """The figures of a subject; out: folder for its pictures and its mesh; photos: folder that `write` filled."""
    with tempfile.TemporaryDirectory() as folder:
        known, truth = rendered(name, photos / slug(name) if photos else Path(folder), render=photos is None)
        made = make(Row(read_capture(known.source), known=known))
        to_shape = to_truth(truth, made.frames)
        mesh, filled = full_mesh(made.bundle), filled_vertices(made.bundle)
        laid = Mesh(mesh.vertices @ to_shape[:3, :3].T + to_shape[:3, 3], mesh.faces, mesh.rgb)
        if out:
            write_pictures(out, made.bundle)
            (out / "mesh.ply").write_bytes(ply_bytes(laid))
        quality = made.bundle.manifest["quality"]
        photo = photo_figures(quality.get("photos") or {})
        return {
            "placed": f"{len(made.frames)} of {len(known.cameras)}",
            "seconds": round(made.seconds, 1),
            "pieces": quality["components"],
            **closing_figures(quality),
            **seam_figures(laid, filled),
            **{title: photo[title] for title in ("cover %", "lace %", "worst lace %", "leak %")},
            **Comparison(laid, truth, filled).figures(),
            **depth_by_luma(truth, made.frames, to_shape),
        }


def main(arguments: list[str]) -> None:
    """Print the table, or write the photos alone."""
    options = _parser().parse_args(arguments)
    names = [name for name in SUBJECTS if all(word in name for word in options.words)]
    if not options.write:
        photos = str(options.photos.resolve()) if options.photos else ""
        print_rows(names, options.out, photos, module="tests.bench.rendered")
        return
    for name in names:
        write(name, options.write / slug(name))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m tests.bench rendered", description=__doc__)
    every = "; ".join(SUBJECTS)
    parser.add_argument("words", nargs="*", help=f"only subjects that contain all of these words; all: {every}")
    parser.add_argument(
        "--write", type=Path, help="write the photos, with cameras and surface, to this folder, no more"
    )
    parser.add_argument("--photos", type=Path, help="folder that --write has filled, not to render again")
    parser.add_argument("--out", type=Path, help="folder for each subject's pictures and an index.html that shows them")
    return parser


if __name__ == "__main__":
    row, out_folder, photo_folder = sys.argv[1:]
    figures = one(row, *(Path(each) if each else None for each in (out_folder, photo_folder)))
    print(json.dumps(figures))
