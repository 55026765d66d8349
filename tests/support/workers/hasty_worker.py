"""The worker with small pictures and checkpoints 0.5 s apart, not 5.

python -m tests.support.workers.hasty_worker edge
"""

from __future__ import annotations

import pytest

from capture2vr.cli.main import main
from capture2vr.edge.field import checkpoint
from tests.support.photos.small_pictures import draw_small

if __name__ == "__main__":
    with pytest.MonkeyPatch.context() as patch:
        draw_small(patch)
        patch.setattr(checkpoint, "SECONDS", 0.5)
        main()
