"""The folder that `capture2vr run` writes: the best mesh on top, the store's layout in `bundle/`, and a report."""

from __future__ import annotations

import json
import uuid
from collections.abc import Mapping
from dataclasses import asdict
from io import BytesIO
from pathlib import Path
from typing import Any

from capture2vr.cli.grade_line import grade_line, origin_line, other_warnings
from capture2vr.cli.local.reference_mesh import read_mesh
from capture2vr.cli.local.report import report_page
from capture2vr.cli.progress import console, warn
from capture2vr.client.earlier_results import BUNDLE, PICTURES, PREVIEW, SOURCE, files_of_both, remove_earlier
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.errors import BadInput
from capture2vr.storage.bundle import Bundle
from capture2vr.storage.catalogue.entry import DEFAULT_COLLECTION
from capture2vr.storage.catalogue.publish import PublishedAsset, PublishPolicy, publish
from capture2vr.storage.local import LocalStore

_PICTURE = "preview.png"  # name of the picture in bundles of both states


class Results:
    """Writes the results to a folder for the user: the best mesh at the top level, the store's layout in `bundle/`.

    When there is a refined mesh, the files of the preview are moved to `preview/`; the pictures of both stay on top.
    """

    def __init__(
        self,
        out: Path,
        key: str,
        collection: str = DEFAULT_COLLECTION,
        reference: Mesh | None = None,
        *,
        capture: Path | None = None,
    ) -> None:
        self.out = out
        self._capture = capture
        self._collection = collection
        self._reference = reference
        self.checkpoint = out / "fit.checkpoint"
        self.report: dict[str, Any] = {}
        self._key = key
        self._job = uuid.uuid4().hex  # one id for both bundles, as a job's preview and refined version have
        self._pictures: dict[str, bytes] = {}
        self._compared: dict[str, bytes] = {}

    def write(self, bundle: Bundle) -> None:
        """Write a bundle's files and update the report. Raises BadInput where the capture would be overwritten."""
        self._spare_capture(bundle)
        if bundle.state == "preview":
            remove_earlier(self.out)
        else:
            self._move_preview()
        self.out.mkdir(parents=True, exist_ok=True)
        self._pictures[bundle.state] = bundle.files[_PICTURE]
        for name, content in bundle.files.items():
            (self.out / (f"{bundle.state}.png" if name == _PICTURE else name)).write_bytes(content)
        self._compared = dict(bundle.private)
        for name, content in bundle.private.items():
            (self.out / name).write_bytes(content)
        store = LocalStore(self.out / BUNDLE)
        # Whoever ran this has the files in any case, so the bundle beside them lists them whatever their grade.
        policy = PublishPolicy(anyway=True)
        asset: PublishedAsset = publish(
            bundle, store, key=self._key, job=self._job, collection=self._collection, policy=policy
        )
        quality = bundle.manifest["quality"]
        self._write_report(
            {
                **bundle.manifest,
                "key": self._key,
                "state": bundle.state,
                "version": asset.version,
                "bytes": {name: len(content) for name, content in bundle.files.items()},
                PICTURES: sorted(bundle.private),
                SOURCE: self._source,
                "reference": self._measure_distance(bundle.files["mesh.ply"]),
            },
            quality,
        )

    @property
    def _source(self) -> str:
        """The name of the capture if it lies beside the results; else ""."""
        found = self._capture
        return found.name if found and found.resolve().parent == self.out.resolve() else ""

    def _spare_capture(self, bundle: Bundle) -> None:
        """Raises BadInput where one of the results has the capture's name, in the capture's folder."""
        names = (*bundle.files, *bundle.private, f"{bundle.state}.png")
        replaced = (*(self.out / name for name in names), *files_of_both(self.out))
        if self._capture and any(path.exists() and path.samefile(self._capture) for path in replaced):
            raise BadInput(f"{self._capture} would be replaced by the result of that name: name another folder with -o")

    def keep_preview(self, warning: str, quality: Mapping[str, Any] | None, seconds: Mapping[str, float]) -> None:
        """Update the report of a run whose training gave no better mesh, with the rejected mesh's quality figures."""
        refused = quality or {}
        report = {**self.report, "seconds": seconds, "warnings": [*self.report["warnings"], warning]}
        self._write_report(report, {**refused, "preview": self.report["quality"]})

    def _write_report(self, report: dict[str, Any], quality: Mapping[str, Any]) -> None:
        preview = quality.get("preview", quality)
        refined = {key: value for key, value in quality.items() if key != "preview"}
        self.report = {
            **report,
            "verdict": quality.get("verdict", ""),
            "because": quality.get("because", ""),
            "certificates": {"preview": preview, "refined": refined if "verdict" in quality else None},
        }
        (self.out / "report.json").write_text(json.dumps(self.report, indent=2) + "\n")
        (self.out / "report.html").write_text(
            report_page(self.report, self._pictures, self._compared), encoding="utf-8"
        )

    def _measure_distance(self, ply: bytes) -> dict[str, float] | None:
        """Measure the mesh's distances to the reference; None without one."""
        from capture2vr.edge.mesh.align_to_reference import overlay

        return asdict(overlay(read_mesh(BytesIO(ply), "ply"), self._reference)) if self._reference else None

    def _move_preview(self) -> None:
        (self.out / PREVIEW).mkdir()
        for name in self.report["bytes"]:
            if name != _PICTURE:
                (self.out / name).rename(self.out / PREVIEW / name)


def print_result(out: Path, report: dict[str, Any]) -> None:
    """Print what a person wants to know of a result first: its size, its levels of detail, its warnings."""
    quality, seconds = report["quality"], report["seconds"]
    size = " × ".join(f"{side:.3g}" for side in report["size_m"])
    lods = ", ".join(f"{lod['triangles']:,}" for lod in report["lods"])
    if line := origin_line(report["origin"]):
        console.print(line)
    if grade := quality.get("grade"):
        console.print(grade_line(grade))
    console.print(
        f"{report['points']:,} points → {quality['triangles']:,} triangles in {quality['components']:,} pieces, "
        f"{quality['non_manifold_edges']:,} non-manifold edges; {size} m (scale {report['scale_confidence']})"
    )
    console.print(f"LODs {lods} triangles; {sum(seconds.values()):.1f} s in all")
    if tileset := report.get("tileset"):
        console.print(f"{tileset['tiles']:,} tiles of {tileset['triangles']:,} triangles together: {tileset['file']}")
    if report["preset_because"]:
        console.print(f"preset {report['preset']}: {report['preset_because']}")
    if report["verdict"] == "better":
        console.print(f"the refined mesh is better than the preview: {report['because']}")
    if found := report["reference"]:
        console.print(
            f"distance to the reference, after alignment: median {found['median']:.3%} of its size, 90th percentile "
            f"{found['p90']:.3%}; {found['complete']:.1%} of the reference is within 1 %"
        )
    for warning in other_warnings(quality.get("grade"), report["warnings"]):
        warn(warning)
    console.print(f"report: {out / 'report.html'}; all figures: {out / 'report.json'}")
