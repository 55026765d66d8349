"""Access rules: every route names the scopes of which a caller needs one, or that anyone may ask.

`check_rules` refuses a route that has no rule, so that none is forgotten.
"""

from __future__ import annotations

import hmac
from collections.abc import Iterable
from typing import Any

from fastapi import Depends, Request
from fastapi.routing import APIRoute
from starlette.routing import BaseRoute

from capture2vr.gateway.access.authentication import refused
from capture2vr.gateway.access.caller import Caller, Scope, scope_names
from capture2vr.gateway.access.limits import TenantLimits
from capture2vr.gateway.errors import Problem
from capture2vr.gateway.gateway import gateway_of
from capture2vr.gateway.schemas import problems
from capture2vr.sentences.sentence import say

SESSION_COOKIE = "c2v_session"
TENANT_COOKIE = "c2v_tenant"
"""Cookie beside the session's that scripts can read: the tenant that is logged in."""


class Rule:
    """A dependency that authenticates the request and checks the caller's scopes; none: anyone may ask.

    scrapers  whether the token of the metrics is enough, for which nothing is looked up in the database
    """

    def __init__(self, scopes: frozenset[Scope], *, scrapers: bool = False) -> None:
        self.scopes = scopes
        self._scrapers = scrapers

    async def __call__(self, request: Request) -> None:
        if not self.scopes or (self._scrapers and _has_metrics_token(request)):
            return
        caller = await authenticate(request)
        request.state.rate_limit = await gateway_of(request).access.limits.spend(caller)
        if not caller.scopes & self.scopes:
            raise missing_scope(caller, self.scopes)


def needs(*scopes: Scope) -> Any:
    """Return the dependency of a route for callers with one of these scopes; the handler then asks `caller_of`."""
    return Depends(Rule(frozenset(scopes)))


SCRAPERS = Depends(Rule(frozenset({Scope.OPERATE}), scrapers=True))
"""The dependency of the metrics: operators, and who has the token of the metrics."""

ANYONE = Depends(Rule(frozenset()))
"""The dependency of a route that anyone may ask: pages without data, and logging in."""


def _has_metrics_token(request: Request) -> bool:
    token = gateway_of(request).access.metrics_token
    sent = request.headers.get("authorization", "")
    return bool(token) and hmac.compare_digest(sent.encode(), f"Bearer {token}".encode())


async def authenticate(request: Request) -> Caller:
    """Return who makes the request, and keep it for `caller_of`. Raises Problem for a key or cookie that is refused."""
    cookie = request.cookies.get(SESSION_COOKIE)
    caller = await gateway_of(request).access.authentication.caller(request.headers.get("authorization"), cookie)
    request.state.caller = caller
    return caller


def caller_of(request: Request) -> Caller:
    """Return who makes a request whose route has a rule."""
    caller: Caller = request.state.caller
    return caller


async def limits_of(request: Request) -> TenantLimits:
    """Return the limits of the caller's tenant; none for a caller without a key."""
    caller = caller_of(request)
    return await gateway_of(request).access.limits.of(caller.tenant) if caller.key else TenantLimits()


def check_rules(routes: Iterable[BaseRoute]) -> None:
    """Raises RuntimeError where one of these routes has no access rule: a fault of the program."""
    bare = [route.path for route in routes if isinstance(route, APIRoute) and _rule_of(route) is None]
    if bare:
        raise RuntimeError(f"these routes have no access rule: {', '.join(bare)}")


def describe_rules(routes: Iterable[BaseRoute], document: dict[str, Any]) -> None:
    """Add to an OpenAPI document how callers authenticate, the scopes that each route needs, and its refusals."""
    schemes = document.setdefault("components", {}).setdefault("securitySchemes", {})
    schemes["key"] = {"type": "http", "scheme": "bearer", "description": "An access key, c2v_TENANT_…"}
    schemes["session"] = {"type": "apiKey", "in": "cookie", "name": SESSION_COOKIE}
    for route in routes:
        if not isinstance(route, APIRoute) or not route.include_in_schema:
            continue
        rule = _rule_of(route)
        if rule is None or not rule.scopes:
            continue
        for method in route.methods or ():
            operation = document["paths"][route.path_format][method.lower()]
            operation["security"] = [{"key": []}, {"session": []}]
            operation["x-scopes"] = scope_names(rule.scopes)
            for status, answer in problems(401, 403, 429).items():
                operation["responses"].setdefault(str(status), answer)


def _rule_of(route: APIRoute) -> Rule | None:
    return next((each.dependency for each in route.dependencies if isinstance(each.dependency, Rule)), None)


def missing_scope(caller: Caller, scopes: frozenset[Scope]) -> Problem:
    """Return the problem for a caller without any of these scopes."""
    if caller.via == "anonymous":
        return refused("KEY_MISSING", say("needs_access_key"), say("log_in_login_send_authorization"))
    wanted = " or ".join(scope_names(scopes))
    detail = say("needs_scope_access_key", wanted=wanted, scopes=", ".join(scope_names(caller.scopes)) or "none")
    return Problem(403, "SCOPE_MISSING", detail, hints=(say("use_key_with_scope"),))
