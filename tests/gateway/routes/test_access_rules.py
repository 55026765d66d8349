"""Access rules: a route without one does not start."""

from __future__ import annotations

import pytest
from fastapi import APIRouter

from capture2vr.gateway.access.caller import Scope
from capture2vr.gateway.routes.access_rules import ANYONE, check_rules, needs


def test_a_route_without_a_rule_is_refused_by_name() -> None:
    router = APIRouter(prefix="/v1")
    router.get("/open", dependencies=[ANYONE])(lambda: None)
    router.get("/read", dependencies=[needs(Scope.READ)])(lambda: None)
    check_rules(router.routes)
    router.get("/forgotten")(lambda: None)
    with pytest.raises(RuntimeError, match=r"no access rule: /v1/forgotten$"):
        check_rules(router.routes)
