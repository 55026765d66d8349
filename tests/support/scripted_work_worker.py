"""A worker process of quick work: `python -m tests.support.scripted_work_worker`, with EDGE_* and STORAGE_*."""

from __future__ import annotations

import sys

from services.edge.worker.server import serve
from services.edge.worker.settings import EdgeSettings
from services.logs import configure
from services.storage.settings import StorageSettings, open_store
from tests.support.scripted_work import Making

if __name__ == "__main__":
    configure("INFO")
    sys.exit(serve(EdgeSettings(), Making(open_store(StorageSettings()))))
