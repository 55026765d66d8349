"""Create, read, replace, delete and list the scenes of a tenant: one document each, replaced by compare-and-swap.

A replacement names the version that it was made from. Where that is not the present one nothing is written, so that of
two people who move things at the same time neither loses a change without being told.
"""

from __future__ import annotations

import logging
import secrets
import time
from dataclasses import replace

from capture2vr.sentences.sentence import say
from capture2vr.storage.catalogue.compare_and_swap import canonical_json, now_iso, put_mutable, read_mutable
from capture2vr.storage.catalogue.faults import CatalogueFault
from capture2vr.storage.scenes.scene import PlacedAsset, Scene, parse_scene
from capture2vr.storage.store import ConditionFailed, Head, Store

MOST_SCENES = 1_000
"""Most scenes of a tenant: at most some 10 KB each."""
_PREFIX, _SUFFIX = "scenes/", ".json"

_log = logging.getLogger(__name__)


class SceneChanged(Exception):  # noqa: N818 - not a fault: somebody else was faster
    """A scene is not the one that the change was made from. present: the one that it is now"""

    def __init__(self, present: Scene) -> None:
        super().__init__(say("scene_now_version", scene=present.id, version=present.version))
        self.present = present


class TooManyScenes(Exception):  # noqa: N818 - a limit, not a fault
    """The tenant has as many scenes as it may have."""


def scene_name(scene: str) -> str:
    """Return the object name of a scene's document."""
    return f"{_PREFIX}{scene}{_SUFFIX}"


def create_scene(store: Store, name: str, items: tuple[PlacedAsset, ...]) -> Scene:
    """Store a new scene and return it. Raises TooManyScenes, OSError."""
    if len(store.list(_PREFIX, limit=MOST_SCENES)) >= MOST_SCENES:
        raise TooManyScenes
    now = now_iso()
    # Ids begin with the time of creation, so that lists are in its order.
    scene = Scene(f"scn_{int(time.time() * 1000):012x}{secrets.token_hex(6)}", name, 1, now, now, items)
    put_mutable(store, scene_name(scene.id), canonical_json(scene.as_json), None)
    return scene


def read_scene(store: Store, scene: str) -> Scene:
    """Read a scene. Raises FileNotFoundError for an unknown one, CatalogueFault for a damaged one, OSError."""
    name = scene_name(scene)
    return parse_scene(name, store.get(name))


def replace_scene(store: Store, scene: str, version: int, name: str, items: tuple[PlacedAsset, ...]) -> Scene:
    """Replace a scene's name and things, if its version is still `version`, and return the new one.

    Raises FileNotFoundError, SceneChanged, CatalogueFault, OSError.
    """
    object_name = scene_name(scene)
    data, etag = read_mutable(store, object_name)
    if data is None:
        raise FileNotFoundError(object_name)
    present = parse_scene(object_name, data)
    if present.version != version:
        raise SceneChanged(present)
    changed = replace(present, name=name, items=items, version=version + 1, updated=now_iso())
    try:
        put_mutable(store, object_name, canonical_json(changed.as_json), etag)
    except ConditionFailed:
        written = read_scene(store, scene)
        if written != changed:  # an earlier attempt may have succeeded, whose answer was lost
            raise SceneChanged(written) from None
    return changed


def delete_scene(store: Store, scene: str) -> None:
    """Delete a scene; its assets stay. Raises FileNotFoundError, OSError."""
    store.head(scene_name(scene))
    store.delete(scene_name(scene))


def list_scenes(store: Store, *, after: str = "", limit: int = 50) -> tuple[list[Scene], str | None]:
    """Return the scenes behind `after`, oldest first, and the value of `after` for the next page (None: no more).

    At most `limit` documents are read; damaged ones are left out and logged. Raises OSError.
    """
    heads = store.list(_PREFIX, after=scene_name(after) if after else "", limit=limit + 1)
    found = [scene for head in heads[:limit] if (scene := _scene_at(store, head)) is not None]
    return found, _id_of(heads[limit - 1]) if len(heads) > limit else None


def _scene_at(store: Store, head: Head) -> Scene | None:
    try:
        return parse_scene(head.name, store.get(head.name))
    except FileNotFoundError:
        return None  # deleted since it was listed
    except CatalogueFault as fault:
        _log.warning("a scene is left out of the list: %s", fault)
        return None


def _id_of(head: Head) -> str:
    return head.name.removeprefix(_PREFIX).removesuffix(_SUFFIX)
