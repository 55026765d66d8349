"""`capture2vr visibility`: who may read an asset or a collection besides its tenant."""

from __future__ import annotations

from capture2vr.cli.progress import console
from capture2vr.client.answers import parse_answer
from capture2vr.client.http import open_gateway
from capture2vr.client.names import check_collection, check_key

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
    with open_gateway(gateway) as client:
        answer = parse_answer(client.put(path, json={"visibility": wanted}))
        console.print(f"{name}: {_MEANING[answer['effective']]}")
        console.print(f"{gateway.rstrip('/')}{answer['view']}", soft_wrap=True)
