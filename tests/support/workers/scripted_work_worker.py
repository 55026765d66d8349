"""A worker process of quick work: `python -m tests.support.workers.scripted_work_worker`, with EDGE_* and STORAGE_*."""

from __future__ import annotations

import sys

from capture2vr.edge.worker.server import serve
from capture2vr.edge.worker.settings import EdgeSettings
from capture2vr.process.logs import configure
from capture2vr.storage.settings import StorageSettings, open_store
from tests.support.workers.scripted_work import Making

if __name__ == "__main__":
    configure("INFO")
    sys.exit(serve(EdgeSettings(), Making(open_store(StorageSettings()))))
