"""Images of gateways of later releases, made of this one by a migration more."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from capture2vr.gateway.database.schema import newest_schema
from tests.referees.docker.engine import Engine

EXPANDED, CONTRACTED = "9000_expanded", "9001_contracted"
"""Schemas of the releases that follow: with the first this one works, with the second no more."""

_IMAGE, _OURS = "capture2vr-gateway", "capture2vr-gateway:ours"
_FOLDER = "/venv/lib/python3.11/site-packages/capture2vr/gateway/migrations/"
_EXPAND = """op.add_column("jobs", sa.Column("mood", sa.String(9), nullable=False, server_default="calm"))"""
_CONTRACT = """op.drop_column("jobs", "mood")"""


@contextmanager
def releases(engine: Engine) -> Iterator[None]:
    """Keep this release's image, and take it again at the end."""
    engine.docker("tag", _IMAGE, _OURS)
    try:
        yield
    finally:
        take_ours(engine)


def take_ours(engine: Engine) -> None:
    """Have compose take this release's image for gateways."""
    engine.docker("tag", _OURS, _IMAGE)


def take_next(engine: Engine, *, contracted: bool = False) -> None:
    """Have compose take an image of the next release, or of one that this release's gateways cannot work beside."""
    files = {"v9000.py": _module(EXPANDED, newest_schema(), 10, _EXPAND)}
    if contracted:
        files["v9001.py"] = _module(CONTRACTED, EXPANDED, 9000, _CONTRACT)
    with tempfile.TemporaryDirectory(prefix="next-") as folder:
        for name, text in files.items():
            (Path(folder) / name).write_text(text)
            (Path(folder) / name).chmod(0o644)
        lines = [f"FROM {_OURS}", f"COPY {' '.join(files)} {_FOLDER}"]
        (Path(folder) / "Dockerfile").write_text("\n".join(lines))
        engine.docker("build", "-t", _IMAGE, folder)


def _module(revision: str, before: str, least: int, statement: str) -> str:
    return (
        f"import sqlalchemy as sa\nfrom alembic import op\nrevision, down_revision = {revision!r}, {before!r}\n"
        f"least_readable = {least}\n\n\ndef upgrade() -> None:\n    {statement}\n"
    )
