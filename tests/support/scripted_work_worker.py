"""A worker process that publishes quickly: `python -m tests.gateway.making_worker`, with EDGE_* and STORAGE_*."""

from __future__ import annotations

import logging
import sys

from services.edge.server import serve
from services.edge.settings import EdgeSettings
from services.storage.settings import StorageSettings, open_store
from tests.gateway.making import Making

if __name__ == "__main__":
    logging.basicConfig(level=logging.INFO, stream=sys.stderr, format="%(levelname)s %(message)s")
    sys.exit(serve(EdgeSettings(), Making(open_store(StorageSettings()))))
