"""The error that ends a command with one sentence."""


class ReleaseError(Exception):
    """A release that cannot be made as it stands. The message names the file, the reason and what to do."""
