"""Tell a full disk from other faults of files."""

from __future__ import annotations

import errno


def is_disk_full(error: OSError) -> bool:
    """Return whether an error says that the disk, or this user's share of it, has no space left."""
    return error.errno in (errno.ENOSPC, errno.EDQUOT)
