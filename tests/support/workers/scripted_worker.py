"""A worker process of its own, with scripted work, configured by EDGE_*.

python -m tests.support.workers.scripted_worker
"""

from __future__ import annotations

import logging
import sys

from capture2vr.edge.worker.server import serve
from capture2vr.edge.worker.settings import EdgeSettings
from tests.support.workers.edge_client import Scripted

if __name__ == "__main__":
    logging.basicConfig(level=logging.INFO, stream=sys.stderr, format="%(levelname)s %(message)s")
    sys.exit(serve(EdgeSettings(), Scripted()))
