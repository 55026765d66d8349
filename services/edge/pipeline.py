"""The whole method on one page: capture → points → field → mesh → bundle.

Every stage is a plain function of the stage before it. `reconstruct` yields `Progress` at each stage's start and a
`Bundle` whenever there is something worth publishing: first the preview of the local field; a trained field is a second
bundle under the same key, made by the same `_bundle` from another DistanceFn.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from services.edge.arrays import DistanceFn, Floats, Tick
from services.edge.asset import Subject, asset_frame, manifest_of
from services.edge.capture.nouns import Capture
from services.edge.errors import EdgeError
from services.edge.field.denoise import denoise
from services.edge.field.local import local_field
from services.edge.mesh import Mesh, carry_colours, clean, extract, lods, ply_bytes, render_sheet, to_glb
from services.edge.mesh.band import part_of
from services.edge.mesh.spacing import auto_resolution
from services.edge.points import at_most, to_points, unit_frame
from services.edge.preset import Preset
from services.storage.bundle import Bundle, State

# Where each stage begins on the bar, from the seconds of a 10,000-point cloud and of an RGB-D room on two cores.
STAGE_STARTS = {
    "VALIDATING": 0.0,
    "POINT_CLOUD": 0.05,
    "FITTING": 0.25,
    "EXTRACTING": 0.40,
    "TEXTURING": 0.75,
    "PACKING": 0.80,
    "PUBLISHING": 0.95,
}
EXTRACT_SHARE = 0.4  # of the stage's time: extraction, the rest is cleaning


@dataclass(frozen=True, slots=True)
class Progress:
    """How far the whole job is: `fraction` in [0,1] never goes back; `losses` once a field is trained."""

    stage: str
    fraction: float
    message: str = ""
    losses: Mapping[str, float] = field(default_factory=dict)


Watch = Callable[[Progress], None]
"""Hears of progress inside a stage; may raise `Cancelled`, which stops the work between two slabs."""


def unwatched(progress: Progress) -> None:
    """The watch of a caller who does not look."""


def reconstruct(
    capture: Capture,
    preset: Preset,
    *,
    isolate: bool = False,
    label: str = "",
    watch: Watch = unwatched,
) -> Iterator[Progress | Bundle]:
    """Turn a capture into bundles, the preview first.

    isolate removes the supporting plane and clutter; label is the human name kept in the manifest.
    Raises CaptureError where the capture cannot give a surface, Cancelled when `watch` does.
    """
    clock = _Clock()

    yield _starts("POINT_CLOUD", f"reading {capture.format}")
    with clock("POINT_CLOUD"):
        points = to_points(capture, isolate=isolate, tick=_inside("POINT_CLOUD", watch))
        points = at_most(points, preset.most_points)

    yield _starts("FITTING", f"{len(points):,} points")
    with clock("FITTING"):
        unit = unit_frame(points.xyz)
        xyz_unit = denoise(unit.to_unit(points.xyz), tick=_inside("FITTING", watch))
        distance = local_field(xyz_unit)

    subject = Subject(capture, preset, label, points, unit, xyz_unit)
    yield from _bundle(distance, subject, "preview", clock, watch)


def _bundle(
    distance: DistanceFn, subject: Subject, state: State, clock: _Clock, watch: Watch
) -> Iterator[Progress | Bundle]:
    """Mesh a field and pack it: the same for the preview and for a trained field."""
    preset, points, xyz_unit = subject.preset, subject.points, subject.xyz_unit
    resolution = preset.resolution or auto_resolution(xyz_unit, high=preset.finest)
    yield _starts("EXTRACTING", f"{resolution} cells along the longest side")
    with clock("EXTRACTING"):
        tick = _inside("EXTRACTING", watch)
        raw = extract(distance, xyz_unit, resolution=resolution, tick=part_of(tick, 0, EXTRACT_SHARE))
        mesh_unit = clean(raw, xyz_unit, tick=part_of(tick, EXTRACT_SHARE, 1))
        del raw
    if len(mesh_unit.faces) == 0:
        raise EdgeError(
            "EXTRACTION_EMPTY",
            f"no surface was found among {len(points):,} points at {resolution} cells",
            hints=("capture the thing from closer and from more sides",),
        )

    yield _starts("TEXTURING", f"{len(mesh_unit.faces):,} triangles")
    with clock("TEXTURING"):
        if points.rgb is not None:
            mesh_unit = carry_colours(mesh_unit, xyz_unit, points.rgb)
    watch(_starts("TEXTURING", "colours carried"))

    yield _starts("PACKING", "levels of detail")
    with clock("PACKING"):
        full = replace(mesh_unit, vertices=subject.unit.to_world(mesh_unit.vertices))
        to_asset = asset_frame(full.vertices, points)
        tick = _inside("PACKING", watch)
        levels = _levels(full, to_asset, preset, part_of(tick, 0, 0.4))
        files = {f"lod{level}.glb": to_glb(mesh) for level, mesh in enumerate(levels)}
        files["preview.png"] = render_sheet(levels[0], tick=part_of(tick, 0.5, 0.9))
        files["mesh.ply"] = ply_bytes(full)
    manifest = manifest_of(
        subject, mesh_unit=mesh_unit, levels=levels, to_asset=to_asset, resolution=resolution, seconds=clock.seconds
    )
    yield Bundle(state=state, files=files, manifest=manifest)


def _levels(full: Mesh, to_asset: Floats, preset: Preset, tick: Tick) -> tuple[Mesh, ...]:
    """The LODs in the asset frame, finest first."""
    vertices = full.vertices @ to_asset[:3, :3].T + to_asset[:3, 3]
    return lods(replace(full, vertices=vertices), preset.lod_faces, tick=tick)


def _starts(stage: str, message: str) -> Progress:
    return Progress(stage, STAGE_STARTS[stage], message)


def _inside(stage: str, watch: Watch) -> Tick:
    """A tick that maps a stage's own fraction onto the job's."""
    starts = sorted(STAGE_STARTS.values())
    begin = STAGE_STARTS[stage]
    end = next((start for start in starts if start > begin), 1.0)

    def tick(fraction: float) -> None:
        watch(Progress(stage, begin + (end - begin) * float(np.clip(fraction, 0.0, 1.0))))

    return tick


class _Clock:
    """Seconds per stage: `with clock("FITTING"): ...` adds to `clock.seconds["FITTING"]`."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    def __call__(self, stage: str) -> _Clock:
        self._stage = stage
        return self

    def __enter__(self) -> None:
        self._began = time.perf_counter()

    def __exit__(self, *exc: object) -> None:
        spent = time.perf_counter() - self._began
        self.seconds[self._stage] = round(self.seconds.get(self._stage, 0.0) + spent, 3)
