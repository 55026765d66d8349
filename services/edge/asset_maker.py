"""Make surfaces and bundles of one subject: what the preview, the refined bundle and that of a tiled scene share."""

from __future__ import annotations

from collections.abc import Generator, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

from capture2vr.edge.arrays import DistanceFn, Floats, evenly, part_of
from capture2vr.edge.asset.assemble import ColouredLevels, Edition, assemble_bundle, colour_levels
from capture2vr.edge.asset.manifest import AssetSubject, MeasuredSurface
from capture2vr.edge.asset.photo_check import (
    PhotoCheck,
    check_surface_with_photos,
    drop_false_pieces,
    fill_gaps_with_photos,
    trim_rims_with_photos,
)
from capture2vr.edge.asset.turn_to_cameras import turn_to_cameras
from capture2vr.edge.certificate import certify
from capture2vr.edge.errors import EdgeError
from capture2vr.edge.job_resources import JobResources
from capture2vr.edge.mesh.clean import clean
from capture2vr.edge.mesh.extract import extract
from capture2vr.edge.mesh.extract_published import extract_published
from capture2vr.edge.mesh.fill_gaps import FilledMesh
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.mesh.pieces import Piece
from capture2vr.edge.mesh.spacing import auto_resolution
from capture2vr.edge.preset import Extraction
from capture2vr.edge.progress import Bar, Clock, Progress
from capture2vr.edge.render.place_views import in_unit_frame
from capture2vr.sentences.sentence import say
from capture2vr.storage.bundle import Bundle, State

_EXTRACT_SHARE = 0.4  # of the EXTRACTING stage's time is extraction, the rest is cleaning
_ASKED = 20  # photos, evenly chosen, tell which side of a surface is its front


@dataclass(frozen=True, slots=True)
class AssetMaker:
    """Makes the surfaces and bundles of a job's subject, on its clock and progress bar."""

    subject: AssetSubject
    clock: Clock
    bar: Bar
    resources: JobResources

    def surface(
        self, distance: DistanceFn, near: Floats, finest: int, extraction: Extraction = "dual"
    ) -> Generator[Progress, None, MeasuredSurface]:
        """Extract the mesh of a field whose surface lies near the points (N,3), clean it and measure its quality.

        finest  most cells along the longest side, where the preset leaves the resolution to the points
        A mesh of the published extraction stays as it comes. Raises EdgeError EXTRACTION_EMPTY.
        """
        subject = self.subject
        resolution = subject.preset.resolution or auto_resolution(
            near, high=finest, cells_per_spacing=subject.preset.cells_per_spacing
        )
        yield self.bar.begin("EXTRACTING", say("cells_along_longest_side", count=resolution))
        with self.clock("EXTRACTING"):
            if extraction == "published":
                return self._published(distance, near, resolution)
            return self._cleaned(distance, near, resolution)

    def _published(self, distance: DistanceFn, near: Floats, resolution: int) -> MeasuredSurface:
        mesh_unit = extract_published(distance, near, resolution=resolution, tick=self.bar.tick("EXTRACTING"))
        _refuse_empty(mesh_unit, near, resolution)
        return self._measured(distance, self._with_origin(FilledMesh.unfilled(mesh_unit)), resolution)

    def _cleaned(self, distance: DistanceFn, near: Floats, resolution: int) -> MeasuredSurface:
        subject, tick = self.subject, self.bar.tick("EXTRACTING")
        raw = extract(distance, near, resolution=resolution, tick=part_of(tick, 0, _EXTRACT_SHARE))
        specks: list[float] = []
        mesh_unit = clean(raw, near, specks=specks, tick=part_of(tick, _EXTRACT_SHARE, 1))
        del raw
        _refuse_empty(mesh_unit, near, resolution)
        mesh_unit = turn_to_cameras(
            mesh_unit, in_unit_frame(evenly(subject.colours.texture_views, _ASKED), subject.unit)
        )
        mesh_unit, pieces = drop_false_pieces(mesh_unit, subject.colours, subject.unit, specks)
        mesh_unit = trim_rims_with_photos(mesh_unit, subject.colours, subject.unit)
        filled = fill_gaps_with_photos(mesh_unit, subject.colours, subject.unit, subject.fill)
        return self._measured(distance, self._with_origin(filled), resolution, pieces)

    def _with_origin(self, filled: FilledMesh) -> FilledMesh:
        return filled.with_origin_of(self.subject.xyz_unit, self.subject.points.origin)

    def _measured(
        self, distance: DistanceFn, filled: FilledMesh, resolution: int, pieces: tuple[Piece, ...] = ()
    ) -> MeasuredSurface:
        """Measure a surface, and compare it with photos, which tells whether a draft is held back."""
        certificate = certify(distance, filled.mesh, self.subject.evidence, pieces)
        subject, origin = self.subject, self.subject.source.origin
        # A guess was made to look like its photo, which therefore says nothing about it: it has no grade.
        is_measured = origin == "measured"
        check = check_surface_with_photos(filled.mesh, subject.colours, subject.unit) if is_measured else PhotoCheck()
        certificate = replace(certificate, origin=origin, photos=check.figures)
        return MeasuredSurface(filled, resolution, certificate, check)

    def levels(
        self, surface: MeasuredSurface, to_asset: Floats | None = None
    ) -> Generator[Progress, None, ColouredLevels]:
        """Colour a surface's mesh and make its levels of detail, as `colour_levels`."""
        return colour_levels(surface, self.subject, self.clock, self.bar, to_asset)

    def bundle(
        self,
        surface: MeasuredSurface,
        levels: ColouredLevels,
        state: State,
        quality: Mapping[str, Any],
        *,
        last: bool,
        warnings: tuple[str, ...] = (),
        brief: bool = False,
    ) -> Iterator[Progress | Bundle]:
        """Yield the bundle of a surface whose levels of detail are made, as `assemble_bundle`."""
        edition = Edition(state, quality, last, warnings, brief)
        return assemble_bundle(surface, levels, edition, self.subject, self.clock, self.bar, self.resources)


def _refuse_empty(mesh: Mesh, near: Floats, resolution: int) -> None:
    if len(mesh.faces) == 0:
        raise EdgeError(
            "EXTRACTION_EMPTY",
            say("no_surface_found_among_points", count=len(near), resolution=resolution),
            hints=(say("capture_object_from_closer"),),
        )
