"""The asset frame (metres, Y up, origin on the floor under the object) and the manifest that describes the asset."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

import services
from services.edge.arrays import Floats
from services.edge.certificate import Certificate, Evidence
from services.edge.mesh import Mesh
from services.edge.points import Points, UnitFrame, hints
from services.edge.prepared import Source
from services.edge.preset import Preset
from services.edge.target import Cost, Target

_DEFAULT_UP = np.array(
    [0.0, 1.0, 0.0]
)  # what modelling tools and glTF use; scanners that differ say so in their format


def asset_frame(vertices: Floats, points: Points) -> Floats:
    """(4,4) capture frame -> asset frame, for a mesh with these (V,3) vertices in the capture frame."""
    up = _DEFAULT_UP if points.up is None else np.asarray(points.up, dtype=np.float64)
    linear = points.metres_per_unit * rotation_between(up, _DEFAULT_UP)
    turned = vertices @ linear.T
    low, high = turned.min(axis=0), turned.max(axis=0)
    floor = np.array([(low[0] + high[0]) / 2, low[1], (low[2] + high[2]) / 2])
    to_asset = np.eye(4)
    to_asset[:3, :3] = linear
    to_asset[:3, 3] = -floor
    return to_asset


def rotation_between(source: Floats, target: Floats) -> Floats:
    """(3,3) the smallest rotation taking one unit vector to another (Rodrigues' formula)."""
    axis = np.cross(source, target)
    cosine = float(source @ target)
    if cosine < -1.0 + 1e-9:  # opposite: any axis across will do
        across = np.cross(source, np.eye(3)[np.argmin(np.abs(source))])
        across /= np.linalg.norm(across)
        half_turn: Floats = 2.0 * np.outer(across, across) - np.eye(3)
        return half_turn
    skew = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    rotation: Floats = np.eye(3) + skew + skew @ skew / (1.0 + cosine)
    return rotation


@dataclass(frozen=True, slots=True)
class Subject:
    """What is reconstructed and how it was asked for.

    preset     as named, or as chosen from the points: then `because` says why
    points     those that the field is fitted to; xyz_unit (N,3) the same, denoised, in the unit frame
    colours    all points of the capture, for textures: more of them than a field needs
    target     the device class that it is made for
    evidence   what its surfaces are judged by
    """

    source: Source
    preset: Preset
    because: str
    label: str
    target: Target
    points: Points
    colours: Points
    unit: UnitFrame
    xyz_unit: Floats
    evidence: Evidence


@dataclass(frozen=True, slots=True)
class Surface:
    """A field's mesh in the unit frame, at that many cells along the longest side, and how it was come by.

    steps    of training, 0 for the local field; device: where
    losses   as the training left them
    """

    mesh_unit: Mesh
    resolution: int
    certificate: Certificate
    steps: int = 0
    device: str = "cpu"
    losses: Mapping[str, float] = field(default_factory=dict)

    def quality(self, preset: Preset, seconds: Mapping[str, float]) -> dict[str, Any]:
        """The certificate as the manifest holds it; seconds by stage, up to here."""
        return {
            "resolution": self.resolution,
            **self.certificate.as_json(),
            "preset": preset.name,
            "steps": self.steps,
            "losses": dict(self.losses),
            "device": self.device,
            "seconds": round(sum(seconds.values()), 3),
        }


def manifest_of(
    subject: Subject,
    *,
    quality: Mapping[str, Any],
    costs: Sequence[Cost],
    finest: Mesh,
    to_asset: Floats,
    seconds: Mapping[str, float],
    warnings: Sequence[str],
) -> dict[str, Any]:
    """Everything a client or an engineer may ask of the asset, as JSON; publishing adds names, sizes and hashes.

    costs: of the levels of detail, finest first; finest: the first of them, in the asset frame.
    """
    source, points, unit = subject.source, subject.points, subject.unit
    low, high = finest.vertices.min(axis=0), finest.vertices.max(axis=0)
    told = [*points.warnings, *warnings]
    if points.up is None:
        told.append("nothing in the capture tells which way is up; Y was taken")
    return {
        "generator": f"capture2vr {services.__version__}",
        "label": subject.label,
        "preset": subject.preset.name,
        "preset_because": subject.because,
        "capture": {
            "kind": source.kind,
            "format": source.format,
            "frames": source.frames,
            "photos": [asdict(verdict) for verdict in source.verdicts],
            "unseen": _unseen(points, to_asset),
        },
        "origin": "guess" if source.kind == "image" else "measured",
        "confidence": round(float(points.confidence.mean()), 3),
        "points": len(points) + quality["held_out"],
        "anchors": _anchors(points, to_asset),
        "scale_confidence": points.scale_confidence,
        "capture_to_asset": [float(value) for value in to_asset.ravel()],
        "unit_frame": {"centre": [float(value) for value in unit.centre], "size": float(unit.size)},
        "bounds_m": [low.tolist(), high.tolist()],
        "size_m": (high - low).tolist(),
        "target": subject.target.name,
        "lods": [{"file": f"lod{level}.glb", "level": level, **asdict(cost)} for level, cost in enumerate(costs)],
        "quality": dict(quality),
        "seconds": dict(seconds),
        "warnings": told,
    }


def _unseen(points: Points, to_asset: Floats) -> list[dict[str, Any]]:
    """From where to shoot again; `toward` in the asset frame."""
    turn = to_asset[:3, :3] / np.cbrt(np.linalg.det(to_asset[:3, :3]))
    return [
        {"advice": each.advice, "toward": (turn @ each.toward).round(3).tolist(), "share": round(each.share, 3)}
        for each in points.unseen
    ]


def _anchors(points: Points, to_asset: Floats) -> dict[str, list[float] | list[int]]:
    """Points that stand for the thing until a mesh is loaded: flat lists, metres in the asset frame, and sRGB bytes."""
    xyz, rgb = hints(points.xyz, points.rgb)
    placed = xyz @ to_asset[:3, :3].T + to_asset[:3, 3]
    return {"xyz_m": placed.round(4).ravel().tolist(), "rgb": rgb.ravel().tolist()}
