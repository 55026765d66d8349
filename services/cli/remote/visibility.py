"""`capture2vr visibility`: who may read an asset or a collection besides its tenant."""

from __future__ import annotations

import httpx

from capture2vr.cli.errors import BadInput, parse_answer
from capture2vr.cli.key_names import check_collection, check_key
from capture2vr.cli.progress import console
from capture2vr.cli.remote.http import client_of

INHERITED = "inherited"
"""The choice that leaves it to the asset's collections, or to the gateway."""

_MEANING = {
    "private": "only its tenant may read it, and those to whom it is shared",
    "unlisted": "whoever has its address may read it",
    "public": "everybody may read it",
    None: "as the gateway has it: everybody as long as it asks nobody for a key, then only its tenant",
}


def set_visibility(name: str, visibility: str, gateway: str, *, is_collection: bool) -> None:
    """Set the visibility of an asset or a collection at the gateway, and print what holds. Raises BadInput."""
    if is_collection:
        check_collection(name)
    else:
        check_key(name)
    path = f"/v1/{'collections' if is_collection else 'assets'}/{name}/visibility"
    wanted = None if visibility == INHERITED else visibility
    try:
        with client_of(gateway) as client:
            answer = parse_answer(client.put(path, json={"visibility": wanted}))
    except (httpx.TransportError, httpx.InvalidURL) as error:
        raise BadInput(f"{gateway} cannot be reached: {error}") from error
    console.print(f"{name}: {_MEANING[answer['effective']]}")
    console.print(f"{gateway.rstrip('/')}{answer['view']}", soft_wrap=True)
