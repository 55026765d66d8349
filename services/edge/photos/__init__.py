"""Photos: from pictures to posed depth images, by structure from motion and a plane sweep."""

from __future__ import annotations

from services.edge.photos.depths import finer
from services.edge.photos.to_depth import to_depth

__all__ = ["finer", "to_depth"]
