"""Cache of a job's prepared points beside its checkpoint: after a restart, the next lease of the job reuses them."""

from __future__ import annotations

import logging
from pathlib import Path

from capture2vr.edge.capture_to_points import PreparedPoints
from capture2vr.edge.errors import EdgeError
from capture2vr.edge.jobs.points_archive import read_prepared, write_prepared

_log = logging.getLogger(__name__)

_SUFFIX = ".points"


def save_points(prepared: PreparedPoints, checkpoint: Path) -> Path:
    """Write points beside the checkpoint of this lease, with which they are removed; return the archive's path.

    Raises OSError where they cannot be written.
    """
    archive = checkpoint.with_suffix(_SUFFIX)
    write_prepared(prepared, archive)
    return archive


def has_points(checkpoint: Path) -> bool:
    """Return whether a lease of the job saved points."""
    return any(_archives(checkpoint))


def load_points(checkpoint: Path, scratch: Path) -> PreparedPoints | None:
    """Load the points that the newest lease of the job saved, unpacked into `scratch`; None where none can be read."""
    archives = _archives(checkpoint)
    if not archives:
        return None
    newest = max(archives, key=lambda path: int(path.stem))
    try:
        return read_prepared(newest, scratch)
    except (EdgeError, OSError) as error:  # of another version, or removed with the lease that wrote it
        _log.warning("the saved points in %s cannot be read and are made again: %s", newest, error)
        return None


def _archives(checkpoint: Path) -> list[Path]:
    return [path for path in checkpoint.parent.glob(f"*{_SUFFIX}") if path.stem.isdecimal()]
