"""Points to mesh, by every method of the yardstick: the presets of the product and the literature, Open3D's peers."""

from __future__ import annotations

import io
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from capture2vr.edge.arrays import DistanceFn, Floats
from capture2vr.edge.errors import EdgeError
from capture2vr.edge.field.config import AnchorConfig
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.paper_field.network_config import NetworkConfig

PRODUCT = {"draft": "local field", "standard": "standard", "fine": "fine"}
LITERATURE = {"cap-udf": "CAP-UDF", "levelset-udf": "LevelSetUDF", "paper": "paper"}
PEERS = {"ball-pivoting": "ball pivoting", "poisson": "screened Poisson"}
NAMES = {**PRODUCT, **LITERATURE, **PEERS}
"""Methods, and what tables call them. Any other preset is fitted as those of the literature are."""

MEASURED = ("POINT_CLOUD", "FITTING", "EXTRACTING")  # stages from points to mesh; colours and packing come after it
NEAR = 0.5  # of the points' mean spacing: the offset of the queries for the consistency


class Unavailable(Exception):  # noqa: N818 - not an error: the machine lacks what the method needs
    """The method cannot run here; the message says what is missing."""


@dataclass(frozen=True, slots=True)
class Settings:
    """What a method is run with.

    steps, batch  0 leaves those of the preset, which are the published ones
    bare          the preset's fit alone, without the pipeline that judges it
    changes       fields of the fit's config that differ from the preset or constants of the anchors' fit: for ablations
    """

    method: str
    resolution: int = 128
    steps: int = 0
    batch: int = 0
    seed: int = 0
    device: str = "cpu"
    bare: bool = False
    changes: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Made:
    """A mesh in the frame of the points, the seconds from points to it, and what else there is to say.

    peak_mb      of the process that made it
    consistency  mean of 1 − |cos(g(q), g(q̂))| near the surface; None where there is no field
    remarks      words for the record: what was kept instead, versions
    """

    mesh: Mesh
    seconds: float
    peak_mb: float
    consistency: float | None = None
    remarks: tuple[str, ...] = ()


def make(points: Floats, settings: Settings) -> Made:
    """The mesh of the points (N,3). Raises Unavailable, and EdgeError where the method fails."""
    if settings.method in PEERS:
        return peer(points, settings.method)
    if settings.method in PRODUCT and not settings.bare:
        return product(points, settings)
    return trained(points, settings)


def product(points: Floats, settings: Settings) -> Made:
    """What a client gets for a bare cloud: the whole pipeline, with its own choice between preview and refined."""
    from capture2vr.edge.capture.nouns import Capture, Cloud
    from capture2vr.edge.job_resources import JobResources
    from capture2vr.edge.pipeline import PreviewKept, reconstruct
    from capture2vr.edge.preset import load_preset
    from capture2vr.storage.bundle import Bundle

    preset = replace(load_preset(settings.method), resolution=settings.resolution)
    remarks: tuple[str, ...] = ()
    seconds: Mapping[str, float] = {}
    for step in reconstruct(
        Capture("points", "sampled", Cloud(points)), preset, resources=JobResources(settings.device)
    ):
        if isinstance(step, Bundle):
            bundle, seconds = step, step.manifest["seconds"]
        if isinstance(step, PreviewKept):
            remarks, seconds = (step.warning,), step.seconds
    loaded = trimesh.load_mesh(io.BytesIO(bundle.files["mesh.ply"]), file_type="ply", process=False)
    return Made(
        Mesh(np.asarray(loaded.vertices, np.float64), np.asarray(loaded.faces, np.int64)),
        sum(seconds.get(stage, 0.0) for stage in MEASURED),
        peak_mb(),
        bundle.manifest["quality"].get("consistency"),
        remarks,
    )


def trained(points: Floats, settings: Settings) -> Made:
    """A preset's fit, meshed by the product's own extraction and cleaning; the literature sees the points as measured.

    The extraction that CAP-UDF publishes takes 7 to 51 s and leaves unwelded soup; with ours only the fields differ.
    """
    from capture2vr.edge.certificate import consistency
    from capture2vr.edge.mesh.clean import clean
    from capture2vr.edge.mesh.extract import extract
    from capture2vr.edge.points.unit import unit_frame

    began = time.perf_counter()
    frame = unit_frame(points)
    xyz_unit, distance = fitted(frame.to_unit(points), settings)
    mesh = clean(extract(distance, xyz_unit, resolution=settings.resolution), xyz_unit)
    seconds, peak = time.perf_counter() - began, peak_mb()
    whole = Mesh(frame.to_world(mesh.vertices), mesh.faces)
    return Made(whole, seconds, peak, consistency(distance, near(xyz_unit, settings.seed)))


def fitted(xyz_unit: Floats, settings: Settings) -> tuple[Floats, DistanceFn]:
    """The points that a preset's fit sees, and its field, shortened and changed as the settings say.

    Raises EdgeError, and ValueError for a preset that trains nothing.
    """
    from capture2vr.edge.field.denoise import denoise
    from capture2vr.edge.field.folds import noise_of
    from capture2vr.edge.field.local import local_field
    from capture2vr.edge.paper_field.network_fit import fit_network
    from capture2vr.edge.points.outliers import inliers
    from capture2vr.edge.preset import load_preset

    preset = load_preset(settings.method)
    if preset.fit is None:
        raise ValueError(f"preset '{settings.method}' trains nothing")
    if preset.denoised:
        xyz_unit = xyz_unit[inliers(xyz_unit)]
        xyz_unit = denoise(xyz_unit, noise_of(xyz_unit))
    if isinstance(preset.fit, AnchorConfig):
        return anchored(xyz_unit, preset.fit, settings)
    config = shortened(preset.fit, settings)
    base = local_field(xyz_unit) if config.warm_start else None
    *_, last = fit_network(xyz_unit, config, device=settings.device, base=base)
    return xyz_unit, last.field


def anchored(xyz_unit: Floats, config: AnchorConfig, settings: Settings) -> tuple[Floats, DistanceFn]:
    """As `fitted`, with constants of the anchors' fit changed: each cell is a process of its own."""
    from capture2vr.edge.field import anchor_fit
    from capture2vr.edge.field.anchors import AnchorField
    from capture2vr.edge.points.outliers import inliers

    for constant, value in settings.changes.items():
        setattr(anchor_fit, constant, value)
    config = replace(config, steps=settings.steps or config.steps)
    *_, last = anchor_fit.fit_anchors(xyz_unit[inliers(xyz_unit)], config, device=settings.device)
    assert isinstance(last.field, AnchorField)
    return np.asarray(last.field.points, np.float64), last.field


def shortened(config: NetworkConfig, settings: Settings) -> NetworkConfig:
    """The fit with `settings.steps` in all, every part of its schedule shortened alike."""
    config = replace(config, seed=settings.seed, batch=settings.batch or config.batch, patience=0, **settings.changes)
    if not settings.steps:
        return config
    share = settings.steps / config.loss_steps
    densify = config.densify
    if densify:
        batch = settings.batch or densify.batch
        densify = replace(densify, steps=round(densify.steps * share), batch=batch)
    steps = settings.steps - (densify.steps if densify else 0)
    return replace(config, steps=steps, warm_up=max(1, round(config.warm_up * share)), densify=densify)


def near(xyz_unit: Floats, seed: int, count: int = 10_000) -> Floats:
    """(count,3) queries beside random points, at half their mean spacing."""
    from capture2vr.edge.mesh.spacing import point_spacing

    rng = np.random.default_rng(seed)
    xyz = xyz_unit[rng.integers(len(xyz_unit), size=count)]
    queries: Floats = xyz + rng.normal(0, NEAR * float(np.mean(point_spacing(xyz_unit))), xyz.shape)
    return queries


def peer(points: Floats, method: str) -> Made:
    """A mesh by Open3D, in an interpreter that has it: $OPEN3D_PYTHON, or this one.

    Raises Unavailable where there is none, EdgeError PEER_FAILED with Open3D's last word.
    """
    python = os.environ.get("OPEN3D_PYTHON", sys.executable)
    if subprocess.run([python, "-c", "import open3d"], capture_output=True, check=False).returncode:
        raise Unavailable(f"{python} has no Open3D; install the extra 'bench' or set OPEN3D_PYTHON")
    with tempfile.TemporaryDirectory() as folder:
        source, target = Path(folder) / "points.npz", Path(folder) / "mesh.npz"
        np.savez(source, points=points)
        command = [python, Path(__file__).with_name("peers") / "peers.py", method, source, target]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            said = done.stderr.strip().splitlines() or [f"ended with {done.returncode}"]
            raise EdgeError("PEER_FAILED", said[-1][:200])
        with np.load(target) as made:
            mesh = Mesh(made["vertices"], made["faces"])
            return Made(mesh, float(made["seconds"]), float(made["peak_mb"]), remarks=(str(made["version"]),))


def peak_mb() -> float:
    """Peak resident memory of this process. `ru_maxrss` would start from its parent's, which exec hands down."""
    status = Path("/proc/self/status").read_text()
    return int(status.split("VmHWM:")[1].split()[0]) / 1024
