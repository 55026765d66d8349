"""Reconstruct captures from Python: `mesh_from_points` for a cloud in memory, `reconstruct` for everything else."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Unpack

import numpy as np
from numpy.typing import ArrayLike

from capture2vr.edge.arrays import Floats
from capture2vr.edge.clouds.array_cloud import triples
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.progress import Progress, ignore_progress
from capture2vr.library.pipeline_call import run_pipeline
from capture2vr.library.reconstruction import Reconstruction, reconstruction_of
from capture2vr.library.source import Source, opened, reading_of
from capture2vr.order.job_fields import ReconstructionFields

OnProgress = Callable[[Progress], None]


def mesh_from_points(
    xyz: ArrayLike,
    rgb: ArrayLike | None = None,
    preset: str = "auto",
    *,
    resolution: int = 0,
    device: str = "auto",
    progress: OnProgress = ignore_progress,
    **options: Unpack[ReconstructionFields],
) -> Mesh:
    """Reconstruct the surface of a point cloud; it may be open, such as a garment or a room.

    xyz         (N,3) positions in any unit, at least 100 of them
    rgb         (N,3) sRGB colours, bytes or floats in [0,1]; None: without
    preset      method: "draft" within seconds, "standard" trains a field, … (`capture2vr presets` lists them); "auto"
                chooses by the points and the device
    resolution  cells along the longest side, at most 1024; 0: from the spacing of the points
    device      that trains: "cpu", "cuda", "cuda:1"; "auto": a GPU if there is one
    progress    called with each `Progress`: its stage, and the fraction of the whole that is done
    options     further ones, as of `reconstruct`

    Returns a mesh of V vertices and F triangles, in the frame and the units of the points: `vertices` (V,3) float64,
    `faces` (F,3) int64, `rgb` (V,3) uint8, or None without colours.

    Raises CaptureError for points that cannot describe a surface: of another shape, too few, on a line, not finite;
    EdgeError for an unknown preset, a device that there is not, and where no surface was found.

    >>> import capture2vr
    >>> mesh = capture2vr.mesh_from_points(sphere, preset="draft", resolution=24)
    >>> radius = np.linalg.norm(mesh.vertices, axis=1)
    >>> bool(abs(np.median(radius) - 1) < 0.02)
    True
    """
    points = triples(xyz, "points").astype(np.float64)
    origin = _middle(points)  # far from it float32, which the files have, is coarse
    made = reconstruct(
        points - origin, rgb, preset=preset, resolution=resolution, device=device, progress=progress, **options
    )
    return replace(made.mesh, vertices=made.mesh.vertices + origin)


def reconstruct(
    source: Source,
    rgb: ArrayLike | None = None,
    *,
    preset: str = "auto",
    resolution: int = 0,
    device: str = "auto",
    generator: str = "",
    models: str | Path = "",
    progress: OnProgress = ignore_progress,
    **options: Unpack[ReconstructionFields],
) -> Reconstruction:
    """Reconstruct a capture: photos, a video, a scan of a phone's app, a point cloud or a mesh.

    source      path of a folder, a file or a zip; a `Capture`; or points (N,3) in any unit
    rgb         (N,3) colours, only with points: bytes, or floats in [0,1]
    preset, resolution, device, progress
                as of `mesh_from_points`
    generator   address of a generator, such as "http://127.0.0.1:8080", for the preset "generate" and one photo
                (docs/models.md)
    models      folder of learned models that may help, as the setting EDGE_MODELS of a worker; "": none
    target      device class whose budget the levels of detail must meet: "quest3", "quest2", "web", "archive"
    cut         what to keep: "object", without floor and surroundings; "scene"; "auto", the object if the photos were
                taken around one
    fill        holes of the mesh to fill: "none", "unseen", "all"; default: "unseen" for photos, "none" for clouds
    longest_m   metres between the farthest points of the object, where it was measured
    box         (left, top, right, bottom) of the object in a photo, or (x, y) on it, as shares of the photo's width and
                height, and behind them the photo's name; without one, the first photo
    edits       recipe of what to cut away, what is up and the true size, as in a manifest

    Returns a `Reconstruction`: meshes, levels of detail, textures, certificate and warnings; `.save(folder)` writes it.

    Raises BadInput for a path that there is not and for a value that does not fit; CaptureError, which names the file
    and what to do, where the capture cannot give a surface; EdgeError where the reconstruction fails.

    >>> import capture2vr
    >>> made = capture2vr.reconstruct(sphere, preset="draft", resolution=24)
    >>> len(made.levels), made.levels[0][:4], made.refined is None
    (3, b'glTF', True)
    """
    reading = reading_of(options.get("columns", ""), options.get("unit", ""))
    with opened(source, rgb, reading) as capture:
        made = run_pipeline(
            capture,
            preset,
            options,
            resolution=resolution,
            device=device,
            generator=generator,
            models=models,
            watch=progress,
        )
    return reconstruction_of(made)


def _middle(points: Floats) -> Floats:
    """Return the median (3,) of the points that are finite; zeros where none is."""
    finite = points[np.isfinite(points).all(axis=1)]
    return np.median(finite, axis=0) if len(finite) else np.zeros(3)
