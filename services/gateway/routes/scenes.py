"""/v1/scenes: save several placed assets as a scene, list, read, replace and delete scenes. Two people who change one
thing at the same time do not overwrite each other: a replacement names its version in If-Match.
"""

from __future__ import annotations

import re
from datetime import datetime
from typing import Annotated, Any

from fastapi import APIRouter, Header, Path, Query, Request, Response
from pydantic import BaseModel

from capture2vr.gateway.access.caller import Scope
from capture2vr.gateway.access.readers import Thing
from capture2vr.gateway.errors import Problem
from capture2vr.gateway.gateway import GatewayOf
from capture2vr.gateway.routes.access_rules import caller_of, needs
from capture2vr.gateway.routes.http_ranges import etag_matches
from capture2vr.gateway.routes.read_rules import READS_SCENE, reading_of, unknown_scene
from capture2vr.gateway.routes.store_access import in_thread, page_path, store_of
from capture2vr.gateway.schemas import StrictBody, problems
from capture2vr.sentences.sentence import say
from capture2vr.storage.scenes.scene import SCENE_ID, PlacedAsset, PlacedAssets, Scene, SceneName
from capture2vr.storage.scenes.scene_documents import (
    MOST_SCENES,
    SceneChanged,
    TooManyScenes,
    create_scene,
    delete_scene,
    list_scenes,
    read_scene,
    replace_scene,
)
from capture2vr.storage.store import NO_CACHE

router = APIRouter(prefix="/v1", tags=["scenes"])

_ETAG = re.compile(r'"([1-9][0-9]{0,14})"')

SceneId = Annotated[str, Path(max_length=40, pattern=f"^{SCENE_ID}$", description="Id of a scene.")]


class SceneRequest(StrictBody):
    """An arrangement: its name and its objects, where they stand. `position_m` is in its own frame (metres, Y up, the
    floor at 0), `rotation` a unit quaternion x, y, z, w. Whether the assets exist is not asked.
    """

    name: SceneName
    items: PlacedAssets = ()


class SceneView(BaseModel):
    """An arrangement. `view`: path of its page; `may_place`: whether the viewer lets the caller move objects about;
    `may_save`: whether the caller may replace it. Its ETag is its version.
    """

    id: str
    name: str
    version: int
    created: datetime
    updated: datetime
    items: list[PlacedAsset]
    view: str
    may_place: bool
    may_save: bool


class SceneSummary(BaseModel):
    """An arrangement of the list. `things`: how many objects stand in it."""

    id: str
    name: str
    version: int
    created: datetime
    updated: datetime
    things: int
    view: str


class ScenePage(BaseModel):
    """A page of scenes, oldest first. `next` is the value of `after` for the next page; null on the last page."""

    scenes: list[SceneSummary]
    next: str | None


@router.post(
    "/scenes",
    status_code=201,
    response_model=SceneView,
    dependencies=[needs(Scope.MANAGE)],
    responses=problems(409, 415, 422, 503),
)
async def post_scene(body: SceneRequest, request: Request, response: Response) -> SceneView:
    """Save a new arrangement."""
    store = store_of(request)
    try:
        scene = await in_thread(lambda: create_scene(store, body.name, body.items))
    except TooManyScenes:
        hints = (say("delete_scenes_nobody_needs"),)
        raise Problem(409, "SCENES_LIMITED", say("scenes_already", count=MOST_SCENES), hints=hints) from None
    response.headers["Location"] = f"/v1/scenes/{scene.id}"
    response.headers["ETag"] = _etag(scene)
    return view_of(scene, request)


@router.get("/scenes", response_model=ScenePage, dependencies=[needs(Scope.READ)], responses=problems(422, 503))
async def get_scenes(
    request: Request,
    limit: Annotated[int, Query(ge=1, le=200)] = 50,
    after: Annotated[str, Query(pattern=f"^({SCENE_ID})?$", description="`next` of the previous page.")] = "",
) -> ScenePage:
    """List the scenes, the oldest first. A page may have fewer than `limit` where documents are damaged."""
    store = store_of(request)
    found, following = await in_thread(lambda: list_scenes(store, after=after, limit=limit))
    return ScenePage(scenes=[_summary(scene, request) for scene in found], next=following)


@router.get(
    "/scenes/{scene}", response_model=SceneView, dependencies=[READS_SCENE], responses=problems(404, 410, 422, 503)
)
async def get_scene(scene: SceneId, request: Request, response: Response) -> SceneView | Response:
    """Get a scene. Answers 304 for an ETag in If-None-Match."""
    store = store_of(request)
    try:
        found = await in_thread(lambda: read_scene(store, scene))
    except FileNotFoundError:
        raise unknown_scene(scene) from None
    reading = reading_of(request)
    headers = {"ETag": _etag(found), "Cache-Control": reading.cache_control(NO_CACHE), **reading.cors_headers}
    if etag_matches(request.headers.get("if-none-match"), str(found.version)):
        return Response(status_code=304, headers=headers)
    response.headers.update(headers)
    return view_of(found, request)


@router.put(
    "/scenes/{scene}",
    response_model=SceneView,
    dependencies=[needs(Scope.MANAGE)],
    responses=problems(404, 412, 415, 422, 428, 503),
)
async def put_scene(
    scene: SceneId,
    body: SceneRequest,
    request: Request,
    gateway: GatewayOf,
    response: Response,
    if_match: Annotated[str, Header(max_length=100, description="ETag of the version that was changed.")] = "",
) -> SceneView:
    """Replace an arrangement's name and objects, unless somebody has saved another version meanwhile."""
    version, store = _version_of(if_match), store_of(request)
    try:
        changed = await in_thread(lambda: replace_scene(store, scene, version, body.name, body.items))
    except FileNotFoundError:
        raise unknown_scene(scene) from None
    except SceneChanged as other:
        detail = say("somebody_saved_version_scene_made", version=other.present.version, earlier=version)
        hints = (say("read_scene_again_make_change"),)
        raise Problem(412, "SCENE_CHANGED", detail, hints=hints, headers={"ETag": _etag(other.present)}) from None
    gateway.scenes.news.change(_thing(scene, request))
    response.headers["ETag"] = _etag(changed)
    return view_of(changed, request)


@router.delete(
    "/scenes/{scene}", status_code=204, dependencies=[needs(Scope.MANAGE)], responses=problems(404, 422, 503)
)
async def remove_scene(scene: SceneId, request: Request, gateway: GatewayOf) -> None:
    """Delete a scene for good, and revoke its share links. Its assets stay."""
    store, thing = store_of(request), _thing(scene, request)
    shares = gateway.access.sharing.store
    try:
        await in_thread(lambda: delete_scene(store, scene))
    except FileNotFoundError:
        raise unknown_scene(scene) from None
    await gateway.access.authentication.run(lambda: shares.revoke_all(thing.tenant, thing))
    gateway.scenes.news.change(thing)


def _version_of(if_match: str) -> int:
    """Return the version of an If-Match header. Raises Problem SCENE_VERSION_MISSING for another one, or none."""
    found = _ETAG.fullmatch(if_match.strip())
    if found is None:
        hints = ('send the ETag of GET /v1/scenes/{scene}, such as If-Match: "3"',)
        raise Problem(428, "SCENE_VERSION_MISSING", say("say_version_scene_changed"), hints=hints)
    return int(found[1])


def _thing(scene: str, request: Request) -> Thing:
    """Return the scene of the caller's tenant."""
    return Thing(caller_of(request).tenant, "scene", scene)


def _etag(scene: Scene) -> str:
    return f'"{scene.version}"'


def view_of(scene: Scene, request: Request) -> SceneView:
    """Return a scene as whoever makes the request sees it."""
    reading = getattr(request.state, "reading", None)
    is_own = reading is None or reading.is_own
    return SceneView(
        **_facts(scene, request),
        items=list(scene.items),
        may_place=reading is None or reading.may_place,
        may_save=is_own and Scope.MANAGE in caller_of(request).scopes,
    )


def _summary(scene: Scene, request: Request) -> SceneSummary:
    return SceneSummary(**_facts(scene, request), things=len(scene.items))


def _facts(scene: Scene, request: Request) -> dict[str, Any]:
    """What a view and a summary say alike."""
    return {
        "id": scene.id,
        "name": scene.name,
        "version": scene.version,
        "created": datetime.fromisoformat(scene.created),
        "updated": datetime.fromisoformat(scene.updated),
        "view": page_path(request, f"/scene/{scene.id}"),
    }
