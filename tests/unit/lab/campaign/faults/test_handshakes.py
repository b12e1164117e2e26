"""The row of a flood of handshakes: the rules of the router make the difference, and its kernel counts the flood."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from pcmrs.testing.errors import Unmet
from pcmrs.testing.natlab import NatLab
from pcmrs_lab.campaign.fault import NotRun
from pcmrs_lab.campaign.faults import handshakes
from pcmrs_lab.campaign.faults.handshakes import CONNECTIONS, PORT
from pcmrs_lab.campaign.sham import sham
from tests.unit.lab.campaign.faults.operated import OperatedCell, lab_of, proves, run

HEADER = "  sl  local_address rem_address   st"


def connection(port: int = PORT, state: str = "01") -> str:
    return f"   0: 00000000:{port:04X} 0100007F:1234 {state} 00000000:00000000"


class Net:
    """Two sites and a router.

    Attributes:
        open: Connections at the router; those of a flood are added.
        slow: Time until a client is admitted during a flood without the rules, s.
        loaded: Whether the rules are loaded.
    """

    def __init__(self) -> None:
        self.open = [connection(22), connection(state="06")]
        self.slow, self.quick = 4.0, 0.2
        self.loaded = False
        self.loads = 0
        self.flooded: list[str] = []
        self.refused = ""

    def run(self, place: str, *words: str, timeout: float = 10.0) -> Any:
        output, status = "", 0
        if words[0] == "cat":
            output = "\n".join([HEADER, *self.open])
        elif words[0] == "nft":
            self.loaded, status = not self.loads, self.loads
        elif self.refused:
            status = 1
        else:
            output = str(self.quick if self.loaded or not self.flooded[-1:] or self.flooded[-1] == "0" else self.slow)
        return subprocess.CompletedProcess(words, status, output, self.refused or "no such table")

    def start(self, place: str, *words: str, **_: Any) -> Any:
        lines = iter(["listening\n", "ready\n", ""]) if place == "router" else iter(["flooded\n", ""])
        if place == "remote":
            self.flooded.append(words[-1])
            self.open += [connection()] * int(words[-1])
        ended = self.open.clear if place == "remote" else lambda: None
        return SimpleNamespace(stdout=SimpleNamespace(readline=lambda: next(lines)), communicate=ended)


@pytest.fixture
def net(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Net:
    made = Net()

    @contextmanager
    def lab() -> Iterator[Net]:
        yield made

    rules = tmp_path / "router.nft"
    rules.write_text("table inet router {}")
    monkeypatch.setattr(handshakes, "nat_lab", lab)
    monkeypatch.setattr(handshakes, "RULES", rules)
    return made


def test_the_rules_let_a_client_in(net: Net, tmp_path: Path) -> None:
    found = handshakes._flooded(tmp_path)
    assert proves(found)
    assert found.took_place == {"open_at_the_router_without_the_rules": CONNECTIONS}
    assert found.control == {"let_in_without_the_rules_after_s": 4.0}
    assert found.details["let_in_after_s"] == 0.2
    assert net.loaded


def test_a_client_that_is_let_in_anyhow_proves_nothing(net: Net, tmp_path: Path) -> None:
    net.slow = 0.5
    with pytest.raises(Unmet, match=r"Without the rules, too, the client was admitted after 0\.50 s"):
        handshakes._flooded(tmp_path)
    with sham(), pytest.raises(Unmet, match="Without the rules, too"):
        handshakes._flooded(tmp_path / "sham")
    assert net.flooded == [str(CONNECTIONS)] * 2 + ["0"] * 2


def test_a_client_that_waits_with_the_rules_is_unmet(net: Net, tmp_path: Path) -> None:
    net.quick = 2.0
    with pytest.raises(Unmet, match=r"The client was admitted after 2\.00 s"):
        handshakes._flooded(tmp_path)


def test_rules_that_are_not_loaded_are_unmet(net: Net, tmp_path: Path) -> None:
    net.loads = 1
    with pytest.raises(Unmet, match="The rules are not loaded: no such table"):
        handshakes._flooded(tmp_path)


def test_a_client_that_is_not_admitted_is_unmet(net: Net, tmp_path: Path) -> None:
    net.refused = "No router answers."
    with pytest.raises(Unmet, match="The client was not admitted: No router answers"):
        handshakes._flooded(tmp_path)


def test_only_established_connections_of_the_port_count(net: Net) -> None:
    assert handshakes._established(cast(NatLab, net)) == 0
    net.open += [connection(), connection(), connection(state="02")]
    assert handshakes._established(cast(NatLab, net)) == 2


def test_a_process_that_ends_before_it_is_ready_is_unmet() -> None:
    with pytest.raises(Unmet, match="The process has ended"):
        handshakes._line(cast(Any, SimpleNamespace(stdout=SimpleNamespace(readline=lambda: ""))))


def test_rules_are_part_of_the_source_only(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(handshakes, "RULES", tmp_path / "none.nft")
    with pytest.raises(NotRun, match=r"router\.nft is missing"):
        run(monkeypatch, handshakes.handshake_flood(lab_of(tmp_path, OperatedCell())))


def test_the_rules_that_are_tested_are_those_that_are_deployed() -> None:
    assert handshakes.RULES.is_file()
    assert str(PORT) in handshakes.RULES.read_text()
