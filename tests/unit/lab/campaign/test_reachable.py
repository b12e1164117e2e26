"""A cell that others can reach: who has which certificate, and with what they dial it."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from pcmrs.bus import Credentials
from pcmrs.pki import Authority
from pcmrs_lab.campaign import reachable
from pcmrs_lab.campaign.attacks import attacks
from pcmrs_lab.campaign.reachable import (
    CARRIED,
    DAEMON,
    DEVICE,
    ELSEWHERE,
    EXPIRED,
    FOREIGN,
    PEOPLE,
    REVOKED,
    ROUTER,
    People,
    ReachableCell,
    attacker_of,
    reachable_cell,
)
from tests.unit.lab.campaign.scripted_cell import ScriptedCell, ScriptedLab


@pytest.fixture(scope="module")
def people(tmp_path_factory: pytest.TempPathFactory) -> People:
    return People(tmp_path_factory.mktemp("people"), "lab/*")


def test_everyone_has_the_role_of_the_table(people: People) -> None:
    known = {each.name: each for each in people.authority.identities()}
    assert {name: known[name].role for name in PEOPLE} == PEOPLE
    assert {name for name, each in known.items() if each.revoked is not None} == {REVOKED}
    assert {name for name, each in known.items() if each.via} == {CARRIED, REVOKED, ELSEWHERE}
    assert known[CARRIED].via == (ROUTER,)
    assert {name for name, each in known.items() if each.cells != ("lab/*",)} == {ELSEWHERE}
    assert known[EXPIRED].ends < known["anna"].begins
    assert people.register.is_file()


@pytest.mark.parametrize("name", ["anna", REVOKED, EXPIRED, FOREIGN])
def test_credentials_name_files_that_exist(people: People, name: str) -> None:
    given = people.credentials(name)
    assert given.name == ("anna" if name == FOREIGN else name)
    assert all(Path(each).is_file() for each in (given.certificate, given.key, given.authority))


def test_the_foreign_anna_trusts_this_site_but_is_not_of_it(people: People) -> None:
    foreign, own = people.credentials(FOREIGN), people.credentials("anna")
    assert foreign.authority == own.authority
    assert foreign.certificate != own.certificate
    other = Authority(people.folder / FOREIGN)
    assert [each.name for each in other.identities()] == ["anna"]


def test_a_cell_is_dialled_at_its_endpoint(people: People, tmp_path: Path) -> None:
    key = tmp_path / "key"
    key.write_text("0" * 64 + "\n")
    key.chmod(0o600)
    cell = ReachableCell(ScriptedCell(Path("cell1")).as_cell, people, "tls/127.0.0.1:2000", key)
    assert cell.address == ("127.0.0.1", 2000)
    settings = cell.settings("bob")
    assert (settings.endpoint, settings.cell) == ("tls/127.0.0.1:2000", "cell1")
    assert settings.credentials == people.credentials("bob")
    signer = cell.signer()
    first, second = signer.sign(b"DT_STOP;"), signer.sign(b"DT_STOP;")
    assert b"|panel|1|" in first
    assert b"|panel|2|" in second, "no signature is used twice"


async def test_a_person_is_connected_as_themselves(people: People, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[str, str, Credentials]] = []

    @asynccontextmanager
    async def connect(endpoint: str, *, cell: str, credentials: Credentials) -> AsyncIterator[Any]:
        asked.append((endpoint, cell, credentials))
        yield "client"

    monkeypatch.setattr("pcmrs.client.Client.connect", connect)
    cell = ReachableCell(ScriptedCell(Path("cell1")).as_cell, people, "tls/127.0.0.1:2000", Path("key"))
    async with cell.client("eve") as client:
        assert str(client) == "client"
    assert asked == [("tls/127.0.0.1:2000", "cell1", people.credentials("eve"))]


async def test_the_daemon_gets_identity_register_and_peer(
    people: People, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(reachable, "People", lambda _folder, _cell: people)
    lab = ScriptedLab(tmp_path, ScriptedCell())
    async with reachable_cell(lab.as_lab, "access.routers=[]") as cell:
        assert cell.endpoint.startswith("tls/127.0.0.1:")
    (settings,) = lab.started
    assert settings == (
        f"access.identity={people.folder / 'daemon1'}",
        f"access.register={people.register}",
        f'access.listen=["{cell.endpoint}"]',
        f"gateway.peers.panel.key_file={cell.peer_key}",
        "access.routers=[]",
    )
    assert cell.peer_key.stat().st_mode & 0o777 == 0o600


@pytest.mark.parametrize(
    ("name", "attacker"),
    [
        ("eve", "viewer"),
        ("anna", "operator"),
        (REVOKED, "revoked or expired certificate"),
        (EXPIRED, "revoked or expired certificate"),
        (FOREIGN, "unknown client"),
        (ELSEWHERE, "user of another cell"),
        (ROUTER, "router"),
        (DEVICE, "device"),
        (DAEMON, "daemon"),
    ],
)
def test_everyone_is_an_attacker_of_the_table(name: str, attacker: str) -> None:
    assert attacker_of(name) == attacker
    assert attacker in attacks().attackers
