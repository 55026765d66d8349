"""The asset frame (metres, Y up, origin on the floor under the object) and the manifest that describes the asset."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

import capture2vr
from capture2vr.edge.arrays import Bytes, Floats
from capture2vr.edge.asset.grade import Grade, grade_asset
from capture2vr.edge.asset.photo_check import PhotoCheck
from capture2vr.edge.asset.target import Cost, Target
from capture2vr.edge.capture.facts import CaptureFacts
from capture2vr.edge.certificate import Certificate, Evidence
from capture2vr.edge.mesh.fill_gaps import FilledMesh
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.origin import counts
from capture2vr.edge.points.anchor_points import cluster_anchors
from capture2vr.edge.points.nouns import Points, UnitFrame
from capture2vr.edge.preset import Preset
from capture2vr.order.asset_names import AssetNames
from capture2vr.order.option_table import Fill
from capture2vr.sentences.sentence import say

_TOLD = 0.005  # share of proposed or filled surface from which on a person is told
_DEFAULT_UP = np.array([0.0, 1.0, 0.0])  # as in modelling tools and glTF; scanners that differ say so in their format
_UPRIGHT = 1e-3  # sine of the angle to the vertical below which a direction has no horizontal part to speak of


def asset_frame(vertices: Floats, points: Points) -> Floats:
    """Transform (4,4) from the capture frame to the asset frame, for a mesh with vertices (V,3) in the former.

    Up is Y. What a person called the front looks along Z, to whoever stands before the asset; else the asset is turned
    about the vertical no more than bringing up to Y takes.
    """
    up = _DEFAULT_UP if points.up is None else np.asarray(points.up, dtype=np.float64)
    rotation = rotation_between(up, _DEFAULT_UP)
    if points.edits.front is not None:
        rotation = _turn_to_z(rotation @ np.array(points.edits.front)) @ rotation
    linear = points.metres_per_unit * rotation
    turned = vertices @ linear.T
    low, high = turned.min(axis=0), turned.max(axis=0)
    floor = np.array([(low[0] + high[0]) / 2, low[1], (low[2] + high[2]) / 2])
    to_asset = np.eye(4)
    to_asset[:3, :3] = linear
    to_asset[:3, 3] = -floor
    return to_asset


def _turn_to_z(direction: Floats) -> Floats:
    """(3,3) the rotation about Y that brings a direction over Z; none for one that is upright, which looks nowhere."""
    x, _, z = direction
    length = np.hypot(x, z)
    if length < _UPRIGHT * np.linalg.norm(direction):
        return np.eye(3)
    sine, cosine = x / length, z / length
    return np.array([[cosine, 0, -sine], [0, 1, 0], [sine, 0, cosine]])


def rotation_between(source: Floats, target: Floats) -> Floats:
    """Compute the smallest rotation (3,3) from one unit vector to another (Rodrigues' formula)."""
    axis = np.cross(source, target)
    cosine = float(source @ target)
    if cosine < -1.0 + 1e-6:  # nearly opposite: half a turn about an axis across the target, then what is left
        across = np.cross(target, np.eye(3)[np.argmin(np.abs(target))])
        across /= np.linalg.norm(across)
        half_turn: Floats = 2.0 * np.outer(across, across) - np.eye(3)
        return rotation_between(half_turn @ source, target) @ half_turn
    skew = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    rotation: Floats = np.eye(3) + skew + skew @ skew / (1.0 + cosine)
    return rotation


@dataclass(frozen=True, slots=True)
class AssetSubject:
    """Inputs of an asset that all its bundles share: capture, preset, names, target and points.

    preset     as named, or as chosen from the points: then `because` says why
    points     points that the field is fitted to; xyz_unit (N,3) the same, denoised, in the unit frame
    colours    all points of the capture, for textures: more of them than a field needs
    target     device class that the asset is made for
    fill       which holes of its surface are filled
    evidence   points that its surfaces are compared with
    """

    source: CaptureFacts
    preset: Preset
    because: str
    names: AssetNames
    target: Target
    fill: Fill
    points: Points
    colours: Points
    unit: UnitFrame
    xyz_unit: Floats
    evidence: Evidence


@dataclass(frozen=True, slots=True)
class MeasuredSurface:
    """A field's mesh in the unit frame, with its quality figures and those of the training.

    surface     the mesh, and which of its faces were measured, proposed or filled
    resolution  grid cells along the longest side
    check       comparison with the held-out photos, once it is made
    steps       of training, 0 for the local field; device: where it was trained
    losses      at the end of the training
    """

    surface: FilledMesh
    resolution: int
    certificate: Certificate
    check: PhotoCheck = field(default_factory=PhotoCheck)
    steps: int = 0
    device: str = "cpu"
    losses: Mapping[str, float] = field(default_factory=dict)

    @property
    def mesh_unit(self) -> Mesh:
        """The mesh in the unit frame."""
        return self.surface.mesh

    def warnings(self) -> tuple[str, ...]:
        """Sentences about what a person would notice of the surface."""
        told, shares = [], self.surface.shares
        if shares["measured"] > 0 and shares["proposed"] >= _TOLD:  # a guess that has no other surface says so itself
            told.append(say("surface_proposed_not_measured", share=shares["proposed"]))
        if shares["filled"] >= _TOLD:
            told.append(say("surface_filled_in_photos_show", share=shares["filled"]))
        return (*told, *self.check.warnings())

    @property
    def grade(self) -> Grade | None:
        """How good the surface is; None where there are no photos to tell."""
        return grade_asset(self.certificate, self.check, 1 - self.surface.shares["measured"])

    def quality(self, preset: Preset, seconds: Mapping[str, float]) -> dict[str, Any]:
        """The manifest's `quality` entry: certificate and training; seconds: by stage, up to here."""
        return {
            "resolution": self.resolution,
            **self.certificate.as_json(),
            "origins": self.surface.shares,
            "grade": None if (grade := self.grade) is None else grade.as_json(),
            "preset": preset.name,
            "steps": self.steps,
            "losses": dict(self.losses),
            "device": self.device,
            "seconds": round(sum(seconds.values()), 3),
        }


def build_manifest(
    subject: AssetSubject,
    *,
    quality: Mapping[str, Any],
    costs: Sequence[Cost],
    finest: Mesh,
    to_asset: Floats,
    seconds: Mapping[str, float],
    warnings: Sequence[str],
    grade: Grade | None = None,
) -> dict[str, Any]:
    """Build the asset's manifest as JSON; publishing adds the files' names, sizes and hashes.

    costs: of the levels of detail, finest first; finest: the first of them, in the asset frame;
    grade: of the asset, said before everything else where it is bad.
    """
    source, points, unit = subject.source, subject.points, subject.unit
    low, high = finest.vertices.min(axis=0), finest.vertices.max(axis=0)
    anchors, anchor_colours = anchors_m(points, to_asset)
    all_warnings = [*(grade.warnings() if grade else ()), *points.warnings, *warnings]
    if points.up is None:
        all_warnings.append(say("capture_does_not_say_way"))
    return {
        "generator": f"capture2vr {capture2vr.__version__}",
        **subject.names.as_json,
        "preset": subject.preset.name,
        "preset_because": subject.because,
        "capture": {
            "kind": source.kind,
            "format": source.format,
            "frames": source.frames,
            "photos": [asdict(verdict) for verdict in source.verdicts],
            "unseen": _unseen_sides(points, to_asset),
            "up": _up_source(points),
            "cut": None if points.cut is None else asdict(points.cut),
        },
        "origin": source.origin,
        "origins": counts(subject.colours.origin, len(subject.colours)),
        "confidence": round(float(points.confidence[points.given].mean()), 3),
        "points": int(points.given.sum()) + quality["held_out"],
        "anchors": {"xyz_m": anchors.ravel().tolist(), "rgb": anchor_colours.ravel().tolist()},
        "models": _models(points),
        "edits": points.edits.as_json,
        "scale_confidence": points.scale_confidence,
        "scale_by_model": points.scale_by_model,
        "capture_to_asset": [float(value) for value in to_asset.ravel()],
        "capture_offset": None if points.offset is None else [float(value) for value in points.offset],
        "capture_crs": points.crs or None,
        "unit_frame": {"centre": [float(value) for value in unit.centre], "size": float(unit.size)},
        "bounds_m": [low.tolist(), high.tolist()],
        "size_m": (high - low).tolist(),
        "target": subject.target.name,
        "lods": [{"file": f"lod{level}.glb", "level": level, **asdict(cost)} for level, cost in enumerate(costs)],
        "quality": dict(quality),
        "seconds": dict(seconds),
        "warnings": all_warnings,
    }


def _models(points: Points) -> list[dict[str, str]]:
    """Learned models that had a part in the points, each with its file's hash."""
    return [asdict(model) for model in points.models]


def _up_source(points: Points) -> dict[str, Any] | None:
    """What told which way is up, and its confidence; None where nothing did."""
    source = points.up_source
    return None if source is None else {"source": source.teller, "confidence": source.confidence}


def _unseen_sides(points: Points, to_asset: Floats) -> list[dict[str, Any]]:
    """Sides of the object that no photo shows, with advice for new photos; `toward` in the asset frame."""
    turn = to_asset[:3, :3] / np.cbrt(np.linalg.det(to_asset[:3, :3]))
    return [
        {"advice": each.advice, "toward": (turn @ each.toward).round(3).tolist(), "share": round(each.share, 3)}
        for each in points.unseen
    ]


def anchors_m(points: Points, to_asset: Floats) -> tuple[Floats, Bytes]:
    """Placeholder points for viewers that load the mesh: (K,3) metres in the asset frame, (K,3) sRGB bytes."""
    xyz, rgb = cluster_anchors(points.xyz, points.rgb)
    return (xyz @ to_asset[:3, :3].T + to_asset[:3, 3]).round(4), rgb
