"""A delayed process: which frames a rule delays, how often, and that everything else passes and is counted."""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec
import pytest
import zenoh

import pcmrs.dispatcher._performer
import pcmrs.journal.writer
from pcmrs import failpoints
from pcmrs_lab.campaign import delayed_process
from pcmrs_lab.campaign.delayed_process import Transport
from pcmrs_lab.campaign.delays import Delayed, Rule

HOLD = Rule("receive", "dev/robot/cmd", "hold", times=2)
KEY = "pcmrs/lab/cell1/dev/robot/cmd"


def write(folder: Path, *rules: Rule) -> None:
    """Replaces the rules as a lab does: a new file, so that its number changes."""
    (folder / "rules.new").write_bytes(msgspec.json.encode(list(rules)))
    (folder / "rules.new").replace(folder / "rules")


@pytest.fixture
def transport(tmp_path: Path) -> Transport:
    write(tmp_path, HOLD)
    return Transport(tmp_path)


def test_a_rule_delays_its_frames_and_no_others(transport: Transport) -> None:
    assert transport.rule("send", KEY, b"hold") is None, "at another point"
    assert transport.rule("receive", "pcmrs/lab/cell1/dev/tracker/cmd", b"hold") is None
    assert transport.rule("receive", KEY, b"follow") is None
    assert transport.rule("receive", KEY, b"..hold..") == HOLD


def test_a_rule_delays_only_so_many_frames_of_a_process(transport: Transport) -> None:
    assert [transport.rule("receive", KEY, b"hold") for _ in range(3)] == [HOLD, HOLD, None]


def test_rules_may_change_while_the_process_runs(transport: Transport, tmp_path: Path) -> None:
    assert transport.rule("receive", KEY, b"hold") == HOLD
    other = Rule("publish", "daemon/beat")
    write(tmp_path, HOLD, other)
    assert transport.rule("publish", "pcmrs/lab/cell1/daemon/beat", b"") == other
    assert transport.rule("receive", KEY, b"hold") == HOLD
    assert transport.rule("receive", KEY, b"hold") is None, "its first frame still counts"
    write(tmp_path)
    assert transport.rule("receive", KEY, b"hold") is None


def test_frames_that_pass_meanwhile_have_overtaken_the_late_one(
    transport: Transport, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def sleep(_: float) -> None:
        for payload in (b"follow", b"joints"):
            transport.rule("receive", KEY, payload)
        transport.rule("receive", "pcmrs/lab/cell1/dev/tracker/cmd", b"other")

    monkeypatch.setattr("time.sleep", sleep)
    transport.rule("receive", KEY, b"joints")
    rule = transport.rule("receive", KEY, b"hold")
    assert rule == HOLD
    transport.wait(rule, KEY)
    assert msgspec.json.decode((tmp_path / "begun").read_bytes(), type=Rule) == HOLD
    (line,) = (tmp_path / "done").read_bytes().splitlines()
    found = msgspec.json.decode(line, type=Delayed)
    assert (found.rule, found.overtaken) == (HOLD, 2)


def test_a_delayed_message_goes_on_in_another_thread(transport: Transport) -> None:
    gone = threading.Event()
    threads: list[str] = []

    def go_on() -> None:
        threads.append(threading.current_thread().name)
        gone.set()

    transport.delay_in_thread(HOLD, KEY, go_on)
    assert gone.wait(10.0)
    assert threads != [threading.current_thread().name]


@pytest.fixture
def undone(monkeypatch: pytest.MonkeyPatch) -> pytest.MonkeyPatch:
    """Whatever is replaced in a test is put back."""
    passing = failpoints.failpoint
    for module in [each for each in sys.modules.values() if getattr(each, "failpoint", None) is passing]:
        monkeypatch.setattr(module, "failpoint", passing)
    replaced: tuple[tuple[Any, str], ...] = (
        *((zenoh.Session, "get"), (zenoh.Session, "declare_queryable"), (zenoh.Query, "reply")),
        *((zenoh.Publisher, "put"), (zenoh.ext.AdvancedPublisher, "put")),
    )
    for owner, name in replaced:
        monkeypatch.setattr(owner, name, getattr(owner, name))
    return monkeypatch


def test_failpoints_of_all_modules_are_delayed(undone: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Whichever modules were imported before."""
    write(tmp_path, Rule("pass", "journal.before_commit"))
    undone.setenv("PCMRS_DELAYS", str(tmp_path))
    delayed_process.install()
    writer, performer = (vars(module)["failpoint"] for module in (pcmrs.journal.writer, pcmrs.dispatcher._performer))
    writer("journal.before_commit")
    performer("dispatcher.before_outcome")
    assert writer is performer is failpoints.failpoint
    assert len((tmp_path / "done").read_bytes().splitlines()) == 1


def replaced(undone: pytest.MonkeyPatch, folder: Path, owner: Any, name: str, *rules: Rule) -> tuple[Any, list[Any]]:
    """The function that a delayed process has in place of one of zenoh, and the calls that get through to that."""
    calls: list[Any] = []
    undone.setattr(owner, name, lambda *given, **_: calls.append(given))
    write(folder, *rules)
    undone.setenv("PCMRS_DELAYS", str(folder))
    delayed_process.install()
    return getattr(owner, name), calls


def test_a_request_is_late_and_still_sent(undone: pytest.MonkeyPatch, tmp_path: Path) -> None:
    get, calls = replaced(undone, tmp_path, zenoh.Session, "get", Rule("send", "dev/robot/cmd", "hold"))
    get("session", KEY, payload=b"hold")
    get("session", KEY)
    assert calls == [("session", KEY)] * 2
    assert len((tmp_path / "done").read_bytes().splitlines()) == 1


def test_an_answer_is_late_by_the_words_of_its_request(undone: pytest.MonkeyPatch, tmp_path: Path) -> None:
    reply, calls = replaced(undone, tmp_path, zenoh.Query, "reply", Rule("answer", "dev/robot/cmd", "hold"))
    for payload in (SimpleNamespace(to_bytes=lambda: b"hold"), SimpleNamespace(to_bytes=lambda: b"joints"), None):
        reply(SimpleNamespace(payload=payload), KEY, b"done")
    assert len(calls) == 3
    assert len((tmp_path / "done").read_bytes().splitlines()) == 1


def test_a_message_is_overtaken_by_those_put_after_it(undone: pytest.MonkeyPatch, tmp_path: Path) -> None:
    put, calls = replaced(undone, tmp_path, zenoh.Publisher, "put", Rule("publish", "daemon/beat", seconds=0.01))
    publisher = SimpleNamespace(key_expr="pcmrs/lab/cell1/daemon/beat")
    before = set(threading.enumerate())
    put(publisher, b"first")
    waiting = set(threading.enumerate()) - before
    put(publisher, b"second")
    for thread in waiting:
        thread.join(10.0)
    assert sorted(payload for _, payload in calls) == [b"first", b"second"]
    found = msgspec.json.decode((tmp_path / "done").read_bytes(), type=Delayed)
    assert found.overtaken <= 1


def test_a_request_is_delivered_late_to_its_handler(undone: pytest.MonkeyPatch, tmp_path: Path) -> None:
    declare, calls = replaced(
        undone, tmp_path, zenoh.Session, "declare_queryable", Rule("receive", "dev/robot/cmd", "hold")
    )
    received: list[Any] = []
    done = threading.Event()

    def receive(query: Any) -> None:
        received.append(query.payload)
        done.set()

    declare("session", KEY, receive)
    (handler,) = [each for each in calls[0] if callable(each)]
    answer: Callable[[Any], None] = handler
    answer(SimpleNamespace(key_expr=KEY, payload=None))
    assert received == [None]
    done.clear()
    answer(SimpleNamespace(key_expr=KEY, payload=SimpleNamespace(to_bytes=lambda: b"hold")))
    assert done.wait(10.0)
    assert len(received) == 2
