"""A router between cells and people: certificates only, in the role of a router, and nothing on loopback."""

from __future__ import annotations

from pathlib import Path

import pytest

from pcmrs.clock import SystemClock
from pcmrs.errors import ConfigurationError
from pcmrs.messages.identity import EVERY_CELL
from pcmrs.pki import Authority
from pcmrs.router import router_settings, routing
from pcmrs.testing.daemon import free_port


@pytest.fixture
def lab(tmp_path: Path) -> Path:
    now = SystemClock().wall()
    authority = Authority.init(tmp_path / "pki", "lab", now)
    authority.issue("router", "gate", now, hosts=("127.0.0.1",), cells=EVERY_CELL, into=tmp_path)
    authority.issue("router", "old", now, hosts=("127.0.0.1",), cells=EVERY_CELL, into=tmp_path)
    authority.revoke("old", now)
    authority.issue("operator", "anna", now, cells=EVERY_CELL, into=tmp_path)
    return tmp_path


def register(lab: Path) -> Path:
    return lab / "pki" / "register.json"


def test_a_router_has_no_plain_endpoint_and_denies_by_default(lab: Path) -> None:
    settings = router_settings(lab / "gate", register(lab), ["tls/0.0.0.0:7449"])
    values = settings.zenoh_config()
    assert values["listen/endpoints"] == ["tls/0.0.0.0:7449"]
    assert values["transport/link/tls"]["enable_mtls"]
    assert values["access_control"]["default_permission"] == "deny"
    assert {each.name for each in settings.members} == {"gate", "old", "anna"}


@pytest.mark.parametrize(("identity", "why"), [("anna", "has the role operator, not router"), ("old", "is revoked")])
def test_identity_of_another_role_or_revoked_routes_nothing(lab: Path, identity: str, why: str) -> None:
    with pytest.raises(ConfigurationError, match=why):
        router_settings(lab / identity, register(lab), ["tls/0.0.0.0:7449"])


def test_register_without_the_router_is_an_old_one(lab: Path) -> None:
    other = Authority.init(lab / "other", "lab", SystemClock().wall())
    other.issue("operator", "bob", SystemClock().wall(), cells=EVERY_CELL, into=lab)
    with pytest.raises(ConfigurationError, match="not in the register"):
        router_settings(lab / "gate", lab / "other" / "register.json", [])


async def test_routing_ends_with_its_block_and_may_begin_again(lab: Path) -> None:
    settings = router_settings(lab / "gate", register(lab), [f"tls/127.0.0.1:{free_port()}"])
    for _ in range(2):  # the second needs the port of the first
        async with routing(settings):
            pass
