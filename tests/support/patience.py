"""How long tests wait: generously, because other programs may keep every core busy; only what hangs takes so long."""

PATIENCE_S = 180.0
"""Seconds after which what a test waits for has failed to happen."""

CANCEL_S = 15.0
"""Seconds within which a cancelled thing has ended. On an idle machine that takes less than two; what does not hear of
its cancellation goes on for longer than this."""

HANG_S = 300.0
"""Seconds after which a program that a test has started hangs."""
