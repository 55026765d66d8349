"""Which programs read what is downloaded: formats × readers over real assets, and Blender's own render of each.

`python -m tests.bench formats FOLDER`: FOLDER keeps the assets from run to run. Installs Blender's module, 1.4 GB,
outside the checkout, and unpacks Godot there, 0.5 GB.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from capture2vr.edge.convert.convert_bundle import BundleFolder, convert
from capture2vr.order.download_formats import FORMATS
from tests.bench.data_files import PICTURES, data_file
from tests.referees.formats import readers
from tests.referees.formats.readers import Reader, Reading

CAPTURES = {
    "fruit": "photos_fruit/images",
    "sunflower": "sunflower",
    "t-shirt": "tshirt_folded",
    "living room": "rgbd_livingroom",
    "dress": "dress",
    "milk truck": "milktruck",
    "car": "car",
    "statue": "photos_statue/images",
}
"""Assets by name, and what each is made of: photos, meshes with textures and without, depth images."""
_PROGRAMS = (
    readers.TRIMESH,
    readers.GLTF_TRANSFORM,
    readers.BABYLON,
    readers.USD_CORE,
    readers.BLENDER,
    readers.GODOT,
)
_RENDER = "glb"  # the format that Blender draws
_FOR_OTHERS = ("points-ply", "points-laz", "splats-spz", "splats-glb", "colmap", "transforms")


def main(arguments: list[str]) -> None:
    """Print the table of formats and programs, and that of sizes; write Blender's pictures beside it."""
    readers.install_blender()
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(arguments[0]) if arguments else Path(scratch)
        made = {name: _downloads(_asset(folder, name), Path(scratch) / name) for name in CAPTURES}
        readings = {reader.name: _read_all(reader, made) for reader in _PROGRAMS}
        _draw({name: files[_RENDER] for name, files in made.items()})
        for line in [*_readings_table(made, readings), "", *_sizes_table(made)]:
            print(line)


def _asset(folder: Path, name: str) -> Path:
    """The results of a capture, which are made where they are not there."""
    out = folder / name.replace(" ", "-")
    if not (out / "report.json").is_file():
        command = [sys.executable, "-m", "capture2vr.cli", "run", str(data_file(CAPTURES[name])), "-o", str(out)]
        subprocess.run([*command, "--preset", "draft"], check=True, stdout=subprocess.DEVNULL)
    return out


def _downloads(asset: Path, folder: Path) -> dict[str, Path]:
    """All formats that an asset can have, by name."""
    folder.mkdir(parents=True)
    bundle = BundleFolder(asset, json.loads((asset / "report.json").read_text()))
    made = {}
    for each in FORMATS.values():
        if all(bundle.has(file) for file in each.needs):
            made[each.name] = folder / each.file_name("asset")
            made[each.name].write_bytes(convert(bundle, each.name, "asset"))
    return made


def _readable(reader: Reader, format_name: str) -> bool:
    """Whether a program is asked for a format: points, splats and cameras are for others."""
    if format_name == "glb-meshopt" and reader not in readers.UNPACKS_MESHOPT:
        return False
    ending = ".obj" if format_name == "obj" else Path(FORMATS[format_name].file_name("asset")).suffix
    return ending in reader.endings and format_name not in _FOR_OTHERS


def _read_all(reader: Reader, made: dict[str, dict[str, Path]]) -> dict[tuple[str, str], Reading]:
    """What a program reads, by asset and format."""
    found = {}
    for name, files in made.items():
        asked = [each for each in files if _readable(reader, each)]
        read = reader.read(readers.opened([files[each] for each in asked]))
        found |= {(name, each): reading for each, reading in zip(asked, read, strict=True)}
    return found


def _draw(files: dict[str, Path]) -> None:
    pictures = {file: PICTURES / f"formats-{name.replace(' ', '-')}.jpg" for name, file in files.items()}
    readers.with_blender(list(pictures), pictures)


def _readings_table(
    made: dict[str, dict[str, Path]], readings: dict[str, dict[tuple[str, str], Reading]]
) -> Sequence[str]:
    """A row for each format of each asset that has triangles, a column for each program."""
    lines = [f"| asset | format | {' | '.join(readings)} |", "|---" * (2 + len(readings)) + "|"]
    for name, files in made.items():
        for each in files:
            cells = [_cell(found.get((name, each))) for found in readings.values()]
            if any(cell != "–" for cell in cells):
                lines.append(f"| {name} | `{each}` | {' | '.join(cells)} |")
    return lines


def _cell(reading: Reading | None) -> str:
    if reading is None:
        return "–"
    return reading.fault or f"{reading.triangles:,} {reading.colours}"


def _sizes_table(made: dict[str, dict[str, Path]]) -> Sequence[str]:
    lines = [f"| format, MB | {' | '.join(made)} |", "|---" * (1 + len(made)) + "|"]
    for each in FORMATS:
        sizes = [f"{files[each].stat().st_size / 1e6:.2f}" if each in files else "–" for files in made.values()]
        lines.append(f"| `{each}` | {' | '.join(sizes)} |")
    return lines
