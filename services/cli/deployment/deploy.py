"""`capture2vr deploy init`: secrets, keys and certificates of docker-compose.yml or of the Helm chart."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

app = typer.Typer(no_args_is_help=True)


@app.callback()  # without it Typer would make the only command of the group the group itself
def deploy() -> None:
    """Prepare a deployment with docker-compose.yml, or with the Helm chart."""


@app.command()
def init(
    public_url: Annotated[
        str, typer.Option(help="URL by which phones and headsets reach the service. Default: http://127.0.0.1:PORT.")
    ] = "",
    bind: Annotated[str, typer.Option(help="Address to listen on; 0.0.0.0: all of this machine's.")] = "127.0.0.1",
    port: Annotated[int, typer.Option(min=1, max=65_535, help="Port to listen on.")] = 8080,
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder of docker-compose.yml.")] = Path(),
    force: Annotated[bool, typer.Option("--force", help="Make new secrets where there are some, and say so.")] = False,
    kubernetes: Annotated[
        bool, typer.Option("--kubernetes", help="Write secrets and values for the Helm chart, into OUT/kubernetes.")
    ] = False,
    release: Annotated[str, typer.Option(help="With --kubernetes: name of the Helm release.")] = "vr",
    pool: Annotated[
        list[str] | None, typer.Option(help="With --kubernetes: a pool of workers. Give it again for more.")
    ] = None,
    gateway_class: Annotated[
        str, typer.Option(help="With --kubernetes: GatewayClass to use in place of an Ingress.")
    ] = "",
) -> None:
    """Write .env with random secrets, and the folder `keys` with a signing key and TLS certificates for the workers.

    Run again, it makes what is missing and renews a certificate that ends within 30 days; what exists stays as it is.
    """
    from capture2vr.cli.deployment.deploy_work import Address, initialise
    from capture2vr.cli.deployment.kubernetes_work import Cluster, initialise_cluster

    address = Address(bind, port, public_url)
    if kubernetes:
        pools = tuple(pool or ("cpu", "gpu"))
        initialise_cluster(out / "kubernetes", address, Cluster(release, pools, gateway_class), force=force)
    else:
        initialise(out, address, force=force)
