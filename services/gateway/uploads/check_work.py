"""The check of one upload, in a process of its own with limits: what fork_server.py runs for the gateway.

Messages: `{"file": NAME}` for each file that is begun, then at most one of `{"packed": …}`, `{"refused": …}`,
`{"full": true}` (the disk) and `{"costly": true}` (memory).
"""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

from capture2vr.gateway.database.full_disk import is_disk_full
from capture2vr.gateway.uploads.check_and_pack import CheckOrder, check_and_pack, earlier_archive_of
from capture2vr.gateway.uploads.image_checks import load_pillow
from capture2vr.gateway.uploads.process_limits import limit_process
from capture2vr.gateway.uploads.refusal import Refused
from capture2vr.process.archives import is_zip
from capture2vr.process.fork_server import Talk

# Of processor time, beside what files of this number and size may take: 12 megapixels are checked in 60 ms.
_LEAST_SECONDS, _SECONDS_PER_FILE, _SECONDS_PER_GB = 10.0, 0.02, 100.0
_ENTRY_BYTES = 100  # least of a file in a zip: its name, sizes and times, twice
_MOST_DATA_BYTES = 768 << 20  # of a check, which needs 60 MB, and for a WebP or progressive JPEG of 24 MP 250 MB

load_pillow()


def work(fields: dict[str, Any], talk: Talk) -> None:
    """Check and pack an upload, and send the result, within limits that follow from its size."""
    order = CheckOrder(**fields)
    limit_process(_allowed_seconds(order), _MOST_DATA_BYTES)
    try:
        packed = check_and_pack(order, lambda name: talk.send({"file": name}))
        verdicts = [asdict(verdict) for verdict in packed.verdicts]
        talk.send({"packed": {"sha256": packed.sha256, "verdicts": verdicts}})
    except Refused as refused:
        talk.send({"refused": asdict(refused)})
    except MemoryError:
        talk.send({"costly": True})
    except OSError as error:
        if not is_disk_full(error):
            raise
        talk.send({"full": True})


def _allowed_seconds(order: CheckOrder) -> float:
    """Return the processor time that the check may take."""
    paths = [Path(order.folder, "in", name) for name in order.names]
    paths += [earlier_archive_of(Path(order.folder))] if order.continues else []
    size = sum(path.stat().st_size for path in paths)
    packed = min(order.most_files, size // _ENTRY_BYTES) if any(map(is_zip, paths)) else 0
    return _LEAST_SECONDS + _SECONDS_PER_FILE * max(len(paths), packed) + _SECONDS_PER_GB * size / 1e9
