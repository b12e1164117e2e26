"""Machines of a campaign as network namespaces: each is removed again, after the processes on it have ended."""

from __future__ import annotations

import subprocess
from contextlib import ExitStack
from typing import Any

import pytest

from pcmrs.testing import networks
from pcmrs.testing.networks import Namespaces, lan, namespaces
from tests.support.scripted_programs import Programs


@pytest.fixture
def programs(monkeypatch: pytest.MonkeyPatch) -> Programs:
    return Programs(monkeypatch)


def test_each_place_has_loopback_and_is_removed(programs: Programs) -> None:
    with namespaces(["a", "b"]) as name:
        assert programs.added == [f"{name}-a", f"{name}-b"]
        assert f"ip -n {name}-b link set lo up" in programs.words
        assert programs.deleted == []
    assert programs.deleted == [f"{name}-b", f"{name}-a"]


def test_no_two_campaigns_have_the_same_names(programs: Programs) -> None:
    with namespaces(["a"]) as first, namespaces(["a"]) as second:
        assert first != second


def test_what_was_made_before_an_error_is_removed(programs: Programs) -> None:
    programs.fails = lambda line: line.endswith("link set lo up") and "-b " in line
    with pytest.raises(subprocess.CalledProcessError), namespaces(["a", "b", "c"]):
        pass
    assert len(programs.added) == 2
    assert sorted(programs.added) == sorted(programs.deleted)


def test_machines_of_a_network_have_their_addresses(programs: Programs) -> None:
    with lan() as places:
        assert places.prefix("cell") == ["ip", "netns", "exec", f"{places.name}-cell"]
        places.run("other", "ping", "192.168.1.1")
    assert f"ip netns exec {places.name}-other ping 192.168.1.1" in programs.words
    for machine, address in networks.ADDRESSES.items():
        assert f"ip -n {places.name}-{machine} address add {address}/24 dev lan" in programs.words


@pytest.mark.parametrize("stubborn", [False, True])
def test_processes_end_before_their_machines(programs: Programs, stubborn: bool) -> None:
    programs.stubborn = stubborn
    with lan() as places:
        places.start("other", "sleep", "1000")
        began = len(programs.words)
    ended = ["terminated", *(["killed"] if stubborn else []), "closed"]
    assert programs.words[began : began + len(ended)] == ended
    assert "netns delete" in programs.words[began + len(ended)]


def test_a_machine_that_permits_no_namespaces_is_missing_them(programs: Programs) -> None:
    need = networks.NEEDS[-1]
    assert need.is_met()
    programs.fails = lambda line: "netns add" in line
    assert not need.is_met()


def test_a_command_may_have_any_exit_status(monkeypatch: pytest.MonkeyPatch) -> None:
    given: dict[str, Any] = {}

    def run(words: list[str], **options: Any) -> subprocess.CompletedProcess[str]:
        given.update(options)
        return subprocess.CompletedProcess(words, 3, "", "no route")

    monkeypatch.setattr(subprocess, "run", run)
    with ExitStack() as processes:
        found = Namespaces[str]("pcmrs-1", processes).run("cell", "ping", timeout=2.0)
    assert (found.returncode, found.stderr) == (3, "no route")
    assert (given["check"], given["timeout"]) == (False, 2.0)
