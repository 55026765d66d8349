"""/v1/webhooks: where events of jobs and assets are sent, and what became of each message."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Annotated, Any, Literal

import httpx
from fastapi import APIRouter, Path, Query, Request, Response
from pydantic import BaseModel, Field, StrictBool

from capture2vr.gateway.access.caller import Scope
from capture2vr.gateway.errors import Problem
from capture2vr.gateway.gateway import GatewayOf, gateway_of
from capture2vr.gateway.routes.access_rules import caller_of, needs
from capture2vr.gateway.schemas import Label, StrictBody, problems
from capture2vr.gateway.webhooks.outbox import Message
from capture2vr.gateway.webhooks.send import UrlRefused
from capture2vr.gateway.webhooks.store import Webhook
from capture2vr.sentences.sentence import say

router = APIRouter(prefix="/v1/webhooks", tags=["webhooks"])

_MOST = 20  # webhooks of a tenant

HookId = Annotated[str, Path(max_length=32, pattern=r"^hook_[0-9a-f]+$", description="Id of a webhook.")]
MessageId = Annotated[str, Path(max_length=64, pattern=r"^msg_[0-9a-f]+$", description="Id of a message.")]
EventName = Literal[
    "job.running",
    "job.succeeded",
    "job.failed",
    "job.cancelled",
    "asset.published",
    "asset.held",
    "asset.removed",
    "asset.restored",
    "asset.deleted",
    "data.deleted",
]


class WebhookRequest(StrictBody):
    """A webhook: the URL that gets the events, by POST; no events means all of them."""

    url: Annotated[str, Field(max_length=2_000, description="https://…, an address of the internet.")]
    events: Annotated[tuple[EventName, ...], Field(max_length=50)] = ()
    label: Label = ""


class WebhookView(BaseModel):
    """A webhook. `disabled`: since when nothing is sent, because its receiver answered 410 or somebody disabled it."""

    id: str
    url: str
    events: list[str]
    label: str
    created: datetime
    disabled: datetime | None

    @classmethod
    def of(cls, hook: Webhook) -> WebhookView:
        """Convert a webhook."""
        return cls(**_fields(hook))


class NewWebhookView(WebhookView):
    """A webhook with its `secret`, which is shown this once: it verifies messages, as Standard Webhooks has it."""

    secret: str


class Webhooks(BaseModel):
    """A tenant's webhooks, the oldest first."""

    webhooks: list[WebhookView]


class StateRequest(StrictBody):
    """Whether a webhook is disabled. Messages that waited are sent once it is enabled again."""

    disabled: StrictBool


class MessageView(BaseModel):
    """A message. `state`: waiting, delivered, or given up after ten attempts in a day; `due`: when it is sent next;
    `last_answer`: the receiver's status and the beginning of its answer, or why it could not be asked.
    """

    id: str
    type: str
    state: Literal["waiting", "delivered", "given up"]
    created: datetime
    attempts: int
    due: datetime | None
    ended: datetime | None
    last_answer: str
    payload: str

    @classmethod
    def of(cls, message: Message) -> MessageView:
        """Convert a message."""
        ended = "delivered" if message.delivered else "given up"
        return cls(
            id=message.id,
            type=message.type,
            state="waiting" if message.ended is None else ended,
            created=_utc(message.created),
            attempts=message.attempts,
            due=None if message.due is None else _utc(message.due),
            ended=None if message.ended is None else _utc(message.ended),
            last_answer=message.last_answer,
            payload=message.payload,
        )


class MessagePage(BaseModel):
    """A page of messages, the newest first. `next` is the value of `before` for the next page; null on the last."""

    messages: list[MessageView]
    next: float | None


_OWNER = [needs(Scope.MANAGE)]


@router.post("", status_code=201, response_model=NewWebhookView, dependencies=_OWNER, responses=problems(409, 415, 422))
async def create_webhook(body: WebhookRequest, request: Request, gateway: GatewayOf) -> NewWebhookView:
    """Create a webhook. Its messages follow Standard Webhooks: signed, retried for a day, each with one id."""
    try:
        await gateway.webhooks.deliveries.check(body.url)
    except (UrlRefused, httpx.InvalidURL, OSError) as error:
        hints = ("name an https:// URL that the internet reaches",)
        raise Problem(422, "WEBHOOK_URL_REFUSED", f"no message is sent to this URL: {error}", hints=hints) from None
    store, tenant = gateway.webhooks.store, caller_of(request).tenant
    run = gateway.access.authentication.run
    made = await run(lambda: store.create(tenant, body.url, body.events, body.label, most=_MOST))
    if made is None:
        detail = say("webhooks_already_as_many", count=_MOST)
        raise Problem(409, "WEBHOOKS_LIMITED", detail, hints=(say("delete_one_not_needed"),))
    hook, secret = made
    return NewWebhookView(**_fields(hook), secret=secret)


@router.get("", response_model=Webhooks, dependencies=_OWNER)
async def list_webhooks(request: Request, gateway: GatewayOf) -> Webhooks:
    """List the tenant's webhooks."""
    store, tenant = gateway.webhooks.store, caller_of(request).tenant
    found = await gateway.access.authentication.run(lambda: store.all(tenant))
    return Webhooks(webhooks=[WebhookView.of(hook) for hook in found])


@router.get("/{webhook}", response_model=WebhookView, dependencies=_OWNER, responses=problems(404, 422))
async def get_webhook(webhook: HookId, request: Request) -> WebhookView:
    """Get a webhook."""
    return WebhookView.of(await _require(webhook, request))


@router.delete("/{webhook}", status_code=204, dependencies=_OWNER, responses=problems(404, 422))
async def delete_webhook(webhook: HookId, request: Request, gateway: GatewayOf) -> Response:
    """Delete a webhook and its messages. One that is being sent just now may still arrive."""
    hook = await _require(webhook, request)
    await gateway.access.authentication.run(lambda: gateway.webhooks.store.delete(hook.tenant, webhook))
    return Response(status_code=204)


@router.put("/{webhook}/state", response_model=WebhookView, dependencies=_OWNER, responses=problems(404, 415, 422))
async def set_webhook_state(webhook: HookId, body: StateRequest, request: Request, gateway: GatewayOf) -> WebhookView:
    """Disable a webhook, or enable it again."""
    hook = await _require(webhook, request)
    store = gateway.webhooks.store
    await gateway.access.authentication.run(lambda: store.set_disabled(hook.tenant, webhook, disabled=body.disabled))
    gateway.webhooks.deliveries.wake()
    return WebhookView.of(await _require(webhook, request))


@router.post("/{webhook}/rotate", response_model=NewWebhookView, dependencies=_OWNER, responses=problems(404, 422))
async def rotate_webhook(webhook: HookId, request: Request, gateway: GatewayOf) -> NewWebhookView:
    """Give a webhook a new secret. For a day its messages are signed with the old one too."""
    hook = await _require(webhook, request)
    store = gateway.webhooks.store
    secret = await gateway.access.authentication.run(lambda: store.rotate(hook.tenant, webhook))
    return NewWebhookView(**_fields(hook), secret=secret)


@router.post(
    "/{webhook}/test", status_code=202, response_model=MessageView, dependencies=_OWNER, responses=problems(404, 422)
)
async def test_webhook(webhook: HookId, request: Request, gateway: GatewayOf) -> MessageView:
    """Send a test message, of the type webhook.test."""
    hook = await _require(webhook, request)
    store = gateway.webhooks.store
    message = await gateway.access.authentication.run(lambda: store.send_test(hook.tenant, webhook))
    gateway.webhooks.deliveries.wake()
    return MessageView.of(message)


@router.get("/{webhook}/messages", response_model=MessagePage, dependencies=_OWNER, responses=problems(404, 422))
async def list_messages(
    webhook: HookId,
    request: Request,
    gateway: GatewayOf,
    limit: Annotated[int, Query(ge=1, le=200)] = 50,
    before: Annotated[float, Query(ge=0, le=1e12, description="`next` of the previous page; 0: the newest.")] = 0.0,
) -> MessagePage:
    """List a webhook's messages of the last week, and what became of them."""
    hook = await _require(webhook, request)
    store, behind = gateway.webhooks.store, before or float("inf")
    found = await gateway.access.authentication.run(
        lambda: store.page(hook.tenant, webhook, limit=limit + 1, before=behind)
    )
    more = found[limit - 1].created if len(found) > limit else None
    return MessagePage(messages=[MessageView.of(message) for message in found[:limit]], next=more)


@router.post(
    "/{webhook}/messages/{message}/redeliver",
    status_code=202,
    response_model=MessageView,
    dependencies=_OWNER,
    responses=problems(404, 422),
)
async def redeliver_message(webhook: HookId, message: MessageId, request: Request, gateway: GatewayOf) -> MessageView:
    """Send a message again, with the same id."""
    hook = await _require(webhook, request)
    store = gateway.webhooks.store
    found = await gateway.access.authentication.run(lambda: store.redeliver(hook.tenant, webhook, message))
    if found is None:
        hints = ("messages are kept for a week after they were delivered",)
        raise Problem(404, "MESSAGE_UNKNOWN", f"there is no message {message}", hints=hints)
    gateway.webhooks.deliveries.wake()
    return MessageView.of(found)


async def _require(webhook: str, request: Request) -> Webhook:
    """Raises Problem WEBHOOK_UNKNOWN."""
    gateway, tenant = gateway_of(request), caller_of(request).tenant
    found = await gateway.access.authentication.run(lambda: gateway.webhooks.store.get(tenant, webhook))
    if found is None:
        hints = ("GET /v1/webhooks lists them",)
        raise Problem(404, "WEBHOOK_UNKNOWN", f"there is no webhook {webhook}", hints=hints)
    return found


def _fields(hook: Webhook) -> dict[str, Any]:
    return {
        "id": hook.id,
        "url": hook.url,
        "events": list(hook.events),
        "label": hook.label,
        "created": _utc(hook.created),
        "disabled": None if hook.disabled is None else _utc(hook.disabled),
    }


def _utc(seconds: float) -> datetime:
    return datetime.fromtimestamp(seconds, UTC)
