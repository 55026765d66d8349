"""Rendered photos of what is hard to capture, beside the surface that they show."""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path
from shutil import copytree

from tests.bench.photo_sets import rendered
from tests.support.photos.rendered.photos import SUBJECTS


def write(name: str, out: Path) -> None:
    """Write a subject's photos with their cameras, and its surface as `truth.ply` in the cameras' frame."""
    with tempfile.TemporaryDirectory() as folder:
        known, _ = rendered(name, Path(folder))
        copytree(known.source, out, dirs_exist_ok=True)
    assert known.truth is not None
    known.truth.export(out / "truth.ply")


def main(arguments: list[str]) -> None:
    """Write the folders of the subjects that contain all of the words."""
    parser = argparse.ArgumentParser(prog="python -m tests.bench rendered", description=__doc__)
    parser.add_argument(
        "words", nargs="*", help=f"only subjects that contain all of these words: {', '.join(SUBJECTS)}"
    )
    parser.add_argument("--write", type=Path, required=True, help="folder for a folder of each subject's photos")
    options = parser.parse_args(arguments)
    for name in SUBJECTS:
        if all(word in name for word in options.words):
            write(name, options.write / name.replace(" ", "-"))


if __name__ == "__main__":
    import sys

    main(sys.argv[1:])
