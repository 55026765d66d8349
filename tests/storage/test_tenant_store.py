"""Stores of tenants: each sees its own objects, whatever it names them, and no other's."""

from __future__ import annotations

import string

import pytest
from hypothesis import given
from hypothesis import strategies as st

from capture2vr.storage.memory import MemoryStore
from capture2vr.storage.store import list_all
from capture2vr.storage.tenant_store import DEFAULT_TENANT, store_of_tenant, tenant_of, tenant_prefix, valid_tenant

TENANTS = st.from_regex(r"[a-z0-9][a-z0-9-]{0,31}", fullmatch=True)
SEGMENT = st.text(string.ascii_letters + string.digits + "._-", min_size=1, max_size=12).filter(lambda s: s[0] != ".")
NAMES = st.lists(SEGMENT, min_size=1, max_size=4).map("/".join)


@given(TENANTS, TENANTS, NAMES)
def test_no_tenant_sees_an_object_of_another(one: str, other: str, name: str) -> None:
    whole = MemoryStore()
    store_of_tenant(whole, one).put(name, b"private", content_type="text/plain")
    foreign = store_of_tenant(whole, other)
    if one == other:
        assert foreign.get(name) == b"private"
    elif other != DEFAULT_TENANT:
        assert list(list_all(foreign, "")) == []
        with pytest.raises(FileNotFoundError):
            foreign.get(name)


@given(TENANTS, NAMES)
def test_a_whole_name_tells_its_tenant(tenant: str, name: str) -> None:
    if tenant == DEFAULT_TENANT and name.startswith("tenants/"):
        return  # not a name of the default tenant's: routes let it reach only captures, assets and collections
    whole = MemoryStore()
    store_of_tenant(whole, tenant).put(name, b"1", content_type="text/plain")
    (head,) = whole.list("")
    assert tenant_of(head.name) == (tenant, name)


def test_what_is_older_than_tenants_is_the_default_tenants() -> None:
    whole = MemoryStore()
    assert store_of_tenant(whole, DEFAULT_TENANT) is whole


@pytest.mark.parametrize("name", ["", "Ada", "a_b", "a/b", "..", "-a", "a" * 33, "ä"])
def test_impossible_tenants(name: str) -> None:
    assert not valid_tenant(name)
    with pytest.raises(ValueError, match="not a valid tenant"):
        store_of_tenant(MemoryStore(), name)


@pytest.mark.parametrize("name", ["tenants/", "tenants/ada", "tenants/default/assets/x", "tenants/A/x"])
def test_names_below_tenants_that_nobody_has(name: str) -> None:
    with pytest.raises(ValueError, match="not a"):
        tenant_of(name)


def test_the_prefix_is_part_of_urls() -> None:
    assert store_of_tenant(MemoryStore(), "ada").url("assets/x").endswith(f"/{tenant_prefix('ada')}assets/x")
