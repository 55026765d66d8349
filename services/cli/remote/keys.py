"""`capture2vr keys create | list | revoke | rotate`: access keys, in this machine's database or at a gateway."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from capture2vr.errors import BadInput

app = typer.Typer(help="Create, list and revoke the access keys of a gateway.", no_args_is_help=True)

Data = Annotated[
    Path, typer.Option("--data", help="Data folder of `capture2vr up`; GATEWAY_* variables name another database.")
]
Remote = Annotated[
    str, typer.Option("--gateway", help="URL of a gateway to ask instead, with the access key in CAPTURE2VR_KEY.")
]
_DATA = Path("capture2vr-data")
_OWNER = ("capture", "read", "manage")


@app.command()
def create(
    tenant: Annotated[str, typer.Option(help="Whose key: 1 to 32 of a-z 0-9 -; created if there is none.")] = "",
    scope: Annotated[
        list[str] | None,
        typer.Option(
            help="What the key allows; may be repeated. capture: upload and reconstruct; read: assets; manage: remove, "
            "delete, keys of the tenant; operate: all tenants, metrics. Default: capture, read and manage."
        ),
    ] = None,
    label: Annotated[str, typer.Option(help="What the key is for.")] = "",
    expires_days: Annotated[int, typer.Option(min=0, max=3650, help="Days until it expires; 0: never.")] = 0,
    data: Data = _DATA,
    gateway: Remote = "",
) -> None:
    """Create an access key and print it. It is shown this once; only its hash is stored."""
    from capture2vr.cli.remote.keys_work import KeyOptions, create_key, open_keys

    options = KeyOptions(tenant, tuple(scope or _OWNER), label, expires_days)
    with open_keys(data, gateway, is_first=True) as keys:
        create_key(keys, options)


@app.command(name="list")
def list_command(
    tenant: Annotated[str, typer.Option(help="Only this tenant's keys. Default: all that may be seen.")] = "",
    data: Data = _DATA,
    gateway: Remote = "",
) -> None:
    """List access keys: what they allow, when they expire, when they were used last."""
    from capture2vr.cli.remote.keys_work import list_keys, open_keys

    with open_keys(data, gateway) as keys:
        list_keys(keys, tenant)


@app.command()
def revoke(
    key: Annotated[str, typer.Argument(help="Id of the key, from `keys list`: key_…")],
    data: Data = _DATA,
    gateway: Remote = "",
) -> None:
    """Revoke an access key: it is refused everywhere within a minute."""
    from capture2vr.cli.remote.keys_work import open_keys, revoke_key

    with open_keys(data, gateway) as keys:
        revoke_key(keys, _key_id(key))


@app.command()
def rotate(
    key: Annotated[str, typer.Argument(help="Id of the key, from `keys list`: key_…")],
    grace_days: Annotated[int, typer.Option(min=0, max=3650, help="Days for which the old key goes on.")] = 1,
    data: Data = _DATA,
    gateway: Remote = "",
) -> None:
    """Create a key with the scopes of an old one, and let that one expire."""
    from capture2vr.cli.remote.keys_work import open_keys, rotate_key

    with open_keys(data, gateway) as keys:
        rotate_key(keys, _key_id(key), grace_days)


def _key_id(key: str) -> str:
    """Return the id unchanged. Raises BadInput, without quoting it, for a key that was given in its place."""
    if key.startswith("c2v_"):
        raise BadInput("this is a key, not its id, and now stands in your shell's history: `keys list` tells the id")
    return key
