"""`python -m capture2vr.cli.service_process edge|gateway PARENT`: a service of `capture2vr up`, which ends with it.

The signal is the one that stops a service in order: jobs drain, and the port is free for the next `up`.
"""

from __future__ import annotations

import signal
import sys

from capture2vr.process.parent_death import end_with_parent

if __name__ == "__main__":
    service, parent = sys.argv[1:]
    end_with_parent(int(parent), by=signal.SIGTERM)
    sys.argv[1:] = [service]

    from capture2vr.cli.main import main

    main()
