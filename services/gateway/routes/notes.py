"""/v1/assets/{key}/notes: texts that people pin to places of an asset."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, TypeVar

from fastapi import APIRouter, Path, Request, Response
from fastapi.responses import JSONResponse
from pydantic import BaseModel, Field

from capture2vr.gateway.access.caller import Scope
from capture2vr.gateway.errors import Problem
from capture2vr.gateway.gateway import GatewayOf, gateway_of
from capture2vr.gateway.routes.access_rules import caller_of, needs
from capture2vr.gateway.routes.assets import Key, check_key, read_asset
from capture2vr.gateway.routes.read_rules import READS_ASSET, reading_of, unknown_asset
from capture2vr.gateway.routes.store_access import in_thread, store_of
from capture2vr.gateway.schemas import StrictBody, problems
from capture2vr.storage.catalogue.asset_notes import NOTE_CHARS, Note, NoteRefused, Place, triple
from capture2vr.storage.catalogue.notes_update import UnknownNote, add_note, change_note, remove_note
from capture2vr.storage.store import NO_CACHE

router = APIRouter(prefix="/v1", tags=["assets"])

_T = TypeVar("_T")
_Metres = Annotated[float, Field(ge=-1e5, le=1e5, allow_inf_nan=False)]
_Triple = Annotated[list[_Metres], Field(min_length=3, max_length=3)]
NoteId = Annotated[str, Path(pattern=r"^note_[0-9a-f]{16}$", description="Id of a note.")]
Text = Annotated[str, Field(min_length=1, max_length=NOTE_CHARS, description="Plain text, some lines.")]


class NoteRequest(StrictBody):
    """A text, and the place in the asset frame (metres) to which it is pinned, with the surface's normal."""

    text: Text
    at: _Triple
    normal: _Triple | None = None


class NoteChange(StrictBody):
    """What of a note changes; what is left out, or null, stays. A new place takes its normal along."""

    text: Text | None = None
    at: _Triple | None = None
    normal: _Triple | None = None


class NoteView(BaseModel):
    """A note. `author`: label of the key that pinned it, "" for readers of other tenants; `version`: on which it was
    pinned; `frame`: version in whose frame `at` is. Where that is not the newest, the note may be displaced.
    """

    id: str
    text: str
    at: list[float]
    normal: list[float] | None
    author: str
    created: str
    edited: str
    version: int
    frame: int


class NotesView(BaseModel):
    """All notes of an asset, in the order in which they were pinned, and its newest version."""

    key: str
    version: int
    notes: list[NoteView]


@router.get(
    "/assets/{key}/notes",
    response_model=NotesView,
    dependencies=[READS_ASSET],
    responses=problems(404, 410, 422, 503),
)
async def list_notes(key: Key, request: Request) -> Response:
    """List the notes that are pinned to an asset."""
    found, reading = await read_asset(request, key), reading_of(request)
    views = [_view(each, is_own=reading.is_own) for each in found.notes]
    body = NotesView(key=key, version=found.version, notes=views).model_dump(mode="json")
    headers = {"Cache-Control": reading.cache_control(NO_CACHE), **reading.cors_headers}
    return JSONResponse(body, headers=headers)


@router.post(
    "/assets/{key}/notes",
    status_code=201,
    response_model=NoteView,
    dependencies=[needs(Scope.MANAGE)],
    responses=problems(404, 415, 422, 503),
)
async def pin_note(key: Key, body: NoteRequest, request: Request, gateway: GatewayOf) -> NoteView:
    """Pin a note to an asset: a new catalogue entry, and no new version."""
    store, keys, author = store_of(request), gateway.keys, await _author(request)
    text, at, normal = body.text, triple(body.at), _place(body.normal)
    return _view(
        await _known(key, lambda: add_note(store, key, text=text, at=at, normal=normal, author=author, keys=keys))
    )


@router.patch(
    "/assets/{key}/notes/{note}",
    response_model=NoteView,
    dependencies=[needs(Scope.MANAGE)],
    responses=problems(404, 415, 422, 503),
)
async def change_pinned_note(
    key: Key, note: NoteId, body: NoteChange, request: Request, gateway: GatewayOf
) -> NoteView:
    """Change a note's text or place."""
    store, keys = store_of(request), gateway.keys
    text, at, normal = body.text, _place(body.at), _place(body.normal)
    return _view(await _known(key, lambda: change_note(store, key, note, text=text, at=at, normal=normal, keys=keys)))


@router.delete(
    "/assets/{key}/notes/{note}",
    status_code=204,
    dependencies=[needs(Scope.MANAGE)],
    responses=problems(404, 422, 503),
)
async def remove_pinned_note(key: Key, note: NoteId, request: Request, gateway: GatewayOf) -> None:
    """Remove a note. It is gone: no version has it."""
    store, keys = store_of(request), gateway.keys
    await _known(key, lambda: remove_note(store, key, note, keys))


async def _known(key: str, work: Callable[[], _T]) -> _T:
    """Do the work in a thread. Raises Problem KEY_INVALID, ASSET_UNKNOWN, NOTE_UNKNOWN, NOTE_REFUSED."""
    check_key(key)
    try:
        return await in_thread(work)
    except UnknownNote as unknown:
        hints = (f"GET /v1/assets/{key}/notes lists them",)
        raise Problem(404, "NOTE_UNKNOWN", str(unknown), hints=hints) from None
    except FileNotFoundError:
        raise unknown_asset(key) from None
    except NoteRefused as refused:
        raise Problem(422, "NOTE_REFUSED", str(refused)) from None


def _place(values: list[float] | None) -> Place | None:
    return None if values is None else triple(values)


async def _author(request: Request) -> str:
    """Return the label of the caller's access key; "" without one."""
    key = caller_of(request).key
    authentication = gateway_of(request).access.authentication
    found = await authentication.run(lambda: authentication.store.key(key)) if key else None
    return found.label if found else ""


def _view(note: Note, *, is_own: bool = True) -> NoteView:
    return NoteView(**{**note.as_json, "author": note.author if is_own else ""})
