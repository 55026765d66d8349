"""The worker with small pictures and checkpoints 0.5 s apart, not 5.

python -m tests.support.workers.hasty_worker edge
"""

from __future__ import annotations

import pytest

from capture2vr.cli.main import main
from tests.support.photos.small_pictures import compute_with

if __name__ == "__main__":
    with pytest.MonkeyPatch.context() as patch:
        compute_with(patch, "tests.support.workers.hasty_job")
        main()
