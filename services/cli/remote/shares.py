"""`capture2vr shares create | list | revoke`: links that open an asset or a collection without a login."""

from __future__ import annotations

from typing import Annotated, Literal

import typer

from capture2vr.cli.options import DEFAULT_GATEWAY, Gateway

app = typer.Typer(help="Create, list and revoke links that open an asset without a login.", no_args_is_help=True)

IsCollection = Annotated[bool, typer.Option("--collection", help="NAME is a collection.")]


@app.command()
def create(
    name: Annotated[str, typer.Argument(help="Asset key, or with --collection the name of a collection.")],
    mode: Annotated[
        Literal["read", "place"], typer.Option(help="What visitors may do: read: look; place: move it about, too.")
    ] = "read",
    label: Annotated[str, typer.Option(help="What the link is for.")] = "",
    expires_days: Annotated[int, typer.Option(min=0, max=3650, help="Days until it ends; 0: when revoked.")] = 30,
    collection: IsCollection = False,
    gateway: Gateway = DEFAULT_GATEWAY,
) -> None:
    """Create a share link and print it. Visitors have to type what is in CAPTURE2VR_SHARE_PASSWORD, if anything."""
    from capture2vr.cli.remote.shares_work import ShareOptions, create_share
    from capture2vr.client.http import open_gateway

    options = ShareOptions(name, collection, mode, label, expires_days)
    with open_gateway(gateway) as client:
        create_share(client, options)


@app.command(name="list")
def list_command(gateway: Gateway = DEFAULT_GATEWAY) -> None:
    """List share links: what they open, how often they were opened, and when they end."""
    from capture2vr.cli.remote.shares_work import list_shares
    from capture2vr.client.http import open_gateway

    with open_gateway(gateway) as client:
        list_shares(client)


@app.command()
def revoke(
    share: Annotated[str, typer.Argument(help="Id of the share, from `shares list`: shr_…")],
    gateway: Gateway = DEFAULT_GATEWAY,
) -> None:
    """Revoke a share link: it is refused everywhere within a minute, the CDN included."""
    from capture2vr.cli.remote.shares_work import revoke_share
    from capture2vr.client.http import open_gateway

    with open_gateway(gateway) as client:
        revoke_share(client, share)
