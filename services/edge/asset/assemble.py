"""From a mesh in the unit frame to the bundle that is published: colours, levels, textures, files and manifest."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

from services.edge.appearance import levels_of, packed, pictures_of, textured
from services.edge.arrays import Floats, Tick
from services.edge.asset import Subject, asset_frame, manifest_of
from services.edge.mesh import Mesh, Textured, carry_colours, ply_bytes
from services.edge.mesh.band import part_of
from services.edge.mesh.ktx2 import Ktx2Error
from services.edge.progress import Bar, Clock, Progress
from services.edge.target import cost_of, require_within
from services.storage.bundle import Bundle, State

_LODS_SHARE = 0.3  # of the time that colours take where the levels get textures


def bundled(
    mesh_unit: Mesh,
    subject: Subject,
    state: State,
    quality: Mapping[str, Any],
    warnings: tuple[str, ...],
    clock: Clock,
    bar: Bar,
    *,
    last: bool,
) -> Iterator[Progress | Bundle]:
    """Colour a mesh and pack it with its levels of detail, its picture and its manifest.

    last  whether nothing better follows: then it gets textures, a turning preview and the file for iOS, for which
          nobody waits who wants a first look
    """
    points = subject.points
    yield bar.starts("TEXTURING", f"{len(mesh_unit.faces):,} triangles")
    with clock("TEXTURING"):
        tick = bar.inside("TEXTURING")
        if points.rgb is not None:
            mesh_unit = carry_colours(mesh_unit, subject.xyz_unit, points.rgb)
        full = replace(mesh_unit, vertices=subject.unit.to_world(mesh_unit.vertices))
        to_asset = asset_frame(full.vertices, points)
        levels = levels_of(full, to_asset, subject, part_of(tick, 0, _LODS_SHARE if last else 1))
        rest = part_of(tick, _LODS_SHARE, 1)
        shown, told, failed = _dressed(levels, to_asset, subject, state, rest) if last else (levels, (), None)
    yield bar.starts("PACKING", "files and pictures")
    with clock("PACKING"):
        tick = bar.inside("PACKING")
        files = {f"lod{level}.glb": packed(asset, subject.target) for level, asset in enumerate(shown)}
        costs = [cost_of(glb) for glb in files.values()]
        files |= pictures_of(shown, last=last, tick=tick)
        files["mesh.ply"] = ply_bytes(full)
    manifest = manifest_of(
        subject,
        quality=quality,
        costs=costs,
        finest=levels[0],
        to_asset=to_asset,
        seconds=clock.seconds,
        warnings=(*warnings, *told),
    )
    if state == "refined":
        require_within(subject.target, costs)
    # The last word before the store: a job cancelled by now must publish nothing.
    yield bar.starts("PUBLISHING", f"publishing the {state}")
    yield Bundle(state=state, files=files, manifest=manifest)
    # A preview is kept without its textures, and whatever it costs: better than nothing to look at.
    if failed:
        raise failed
    require_within(subject.target, costs)


def _dressed(
    levels: Sequence[Mesh], to_asset: Floats, subject: Subject, state: State, tick: Tick
) -> tuple[Sequence[Mesh | Textured], tuple[str, ...], Ktx2Error | None]:
    """The levels with textures, and warnings; a preview whose textures cannot be packed has none, and the reason."""
    try:
        return *textured(levels, to_asset, subject, tick), None
    except Ktx2Error as error:
        if state == "refined":
            raise
        return levels, (), error
