"""Commands on a running cell: without a daemon they say so, and what cannot be sent is refused before."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest
from msgspec.structs import replace

from pcmrs.bus import CommandEdge
from pcmrs.cli.cell import event_line
from pcmrs.messages import Command, Reason, StopState, Verdict
from pcmrs.testing.daemon import free_port
from tests.unit.bus.bus_cells import accepted, new_cell, open_bus, snapshot
from tests.unit.cli.command_line import run
from tests.unit.client.small_daemon import Daemon


@pytest.fixture
def nobody() -> str:
    """An endpoint at which nobody listens."""
    return f"tcp/127.0.0.1:{free_port()}"


@pytest.mark.parametrize(
    "words", [["call", "robot.connect"], ["next"], ["state"], ["state", "--json"], ["keys"], ["watch"], ["stop"]]
)
def test_without_a_daemon_the_status_is_3_with_one_error_line(words: list[str], nobody: str) -> None:
    ended = run(*words, "--endpoint", nobody)
    assert ended.exit_code == 3
    assert ended.stdout == ""
    (line,) = ended.stderr.splitlines()
    assert nobody in line
    assert "pcmrs-serve" in line


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["robot.connect", "{index: 0}"], "not JSON"),
        (["robot.connect", "[1, 2]"], "JSON object"),
        (["robot.connect", "5"], "JSON object"),
        (["robot.connect", '{"a": ' + "[" * 20000 + "]" * 20000 + "}"], "not JSON"),
        (["robot.connect", '{"a": ' + "1" * 5000 + "}"], "not JSON"),
        (["robot.connect", "@/no/such/file"], "/no/such/file cannot be read: No such file"),
        (["robot"], "write branch.operation"),
        (["robot."], "write branch.operation"),
    ],
)
def test_a_call_that_cannot_be_meant_is_refused_unsent(words: list[str], text: str) -> None:
    ended = run("call", *words)
    assert ended.exit_code == 2
    assert text in ended.stderr.splitlines()[-1]


def verdict(decision: Any, **more: Any) -> Verdict:
    return Verdict(id="1", branch="robot", operation="connect", decision=decision, state="0", sequence=1, **more)


def test_a_verdict_is_one_line_with_state_reason_and_result() -> None:
    refused = verdict("rejected", reason=Reason(code="busy", text="It moves."))
    assert event_line(refused) == "rejected: robot.connect, robot is in 0: busy: It moves."
    assert event_line(verdict("accepted", result={"points": 1})) == "accepted: robot.connect, robot is in 0: points 1"


def test_a_snapshot_is_one_line_with_all_that_needs_attention() -> None:
    shown = replace(snapshot(7), latched=True, branches={"robot": "1", "placement": "held"})
    assert event_line(shown) == "#7 robot=1 placement=held LATCHED"


@pytest.mark.parametrize(("decision", "status"), [("accepted", 0), ("rejected", 1), ("failed", 5), ("unknown", 6)])
async def test_the_exit_status_of_a_call_is_its_decision(decision: str, status: int) -> None:
    async def submit(command: Command, *, arrived: float | None) -> Verdict:
        return replace(accepted(command), decision=decision, allowed=["robot.hold"])

    async with open_bus(new_cell()) as bus:
        edge = await CommandEdge.open(bus, submit, lambda *_: None, Daemon(bus).stop)
        words = ("--endpoint", bus.settings.endpoint, "--site", bus.settings.site, "--cell", bus.settings.cell)
        ended = await asyncio.to_thread(run, "call", "robot.connect", '{"index": 0}', *words)
        await edge.close()
    assert ended.exit_code == status
    assert ("allowed now: robot.hold" in ended.stdout) == (decision != "accepted")


async def test_state_is_asked_for_once_and_shown_in_columns() -> None:
    async with open_bus(new_cell()) as bus:
        daemon = Daemon(bus)
        words = ("--endpoint", bus.settings.endpoint, "--site", bus.settings.site, "--cell", bus.settings.cell)
        ended = await asyncio.to_thread(run, "state", *words)
    assert ended.exit_code == 0
    shown = snapshot(0)
    title, *lines, flags = ended.stdout.splitlines()
    assert title == f"{shown.blueprint.id} {shown.blueprint.version}"
    assert [tuple(line.split()) for line in lines] == list(shown.branches.items())
    assert flags == "flags: none; sequence 0"
    assert daemon.snapshots == 1


async def test_the_hint_after_stop_names_the_stop_that_it_shows() -> None:
    async with open_bus(new_cell()) as bus:
        daemon = Daemon(bus)
        daemon.shown = {"latched": True, "release": ["robot.acknowledge"], "stop": StopState(number=1, confirmed=True)}
        edge = await CommandEdge.open(bus, daemon.submit, lambda *_: None, daemon.stop)
        words = ("--endpoint", bus.settings.endpoint, "--site", bus.settings.site, "--cell", bus.settings.cell)
        stopped = await asyncio.to_thread(run, "stop", *words)
        daemon.shown["stop"] = StopState(number=7)
        shown = await asyncio.to_thread(run, "state", *words)
        await edge.close()
    hint = "latched until it is acknowledged: pcmrs call robot.acknowledge '{\"stop\": %d}'"
    assert stopped.stdout == f"stopped, and {hint % 1}\n"
    assert hint % 7 in shown.stdout.replace("\n", " ")


@pytest.mark.parametrize(
    ("words", "status", "lines"),
    [
        (["robot.connect"], 0, ["next: robot.connect", "So it is.", "[ ] plan: Plan it"]),
        ([], 0, ["So it is.", "[x] plan: Plan it"]),
    ],
    ids=["operation", "reached"],
)
async def test_next_prints_step_reason_and_stages(words: list[str], status: int, lines: list[str]) -> None:
    async with open_bus(new_cell()) as bus:
        Daemon(bus)
        where = ("--endpoint", bus.settings.endpoint, "--site", bus.settings.site, "--cell", bus.settings.cell)
        ended = await asyncio.to_thread(run, "next", *words, *where)
    assert ended.stdout.splitlines() == lines
    assert ended.exit_code == status
