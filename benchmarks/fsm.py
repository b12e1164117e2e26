"""Events per second of the state machine core, compared with other state machine libraries in one run.

All libraries run the same machine: registration with 4 states, of which `planned` has a nested child with two states;
the cycle of events is plan, touch, complete, register, clear. What happens at an event differs: the peers change a
state; PCMRS moves every branch that the closure of the command names, signals the parent (Rule 2), re-initiates the
child (Rule 3), and checks that each branch has one active state. A closure depends only on the joint state, so the
engine computes it at the first request in a joint state and caches it: in this cycle all are cached after the first
round. The row "closures not cached" is the engine without that cache. A bare dict dispatch is the limit. All take turns
in short rounds, so that changes of the machine's load affect all alike.

    .venv/bin/python benchmarks/fsm.py [--rounds 20] [--events 500] [--json]
"""

from __future__ import annotations

import argparse
import asyncio
import json
import platform
import tempfile
import time
from collections.abc import Awaitable, Callable, Sequence
from pathlib import Path
from statistics import median
from typing import Any

import uvloop
from sismic.interpreter import Interpreter
from sismic.io import import_from_yaml
from statemachine import State, StateChart
from transitions.extensions import HierarchicalMachine
from transitions.extensions.asyncio import HierarchicalAsyncMachine

from pcmrs.clock import SystemClock
from pcmrs.dispatcher import Dispatcher, ProcedureData, Registry, Workflow
from pcmrs.fsm import Change, Denial, Engine, StateSet, close, parse_blueprint
from pcmrs.journal import Journal
from pcmrs.messages import BlueprintTag, Command
from pcmrs.service.restart.recorder import JournalRecorder

BLUEPRINT = b"""
id = "bench"
version = "1"
[branches.registration]
states = { empty = "", planned = "", digitized = "", registered = "" }
operations.plan = { from = ["empty"], to = "planned" }
operations.register = { from = ["digitized"], to = "registered" }
operations.clear = { from = ["*"], to = "empty" }
operations.opened = { from = ["planned"], to = "planned", iio = true }
operations.done = { from = ["planned"], to = "digitized", iio = true }
[branches.digitization]
level = 2
states = { open = "", half = "", all = "" }
emits = { open = "opened", half = "opened", all = "done" }
parent = { branch = "registration", start = "planned", compatible = { open = ["empty", "planned"], half = ["planned"], all = ["digitized", "registered"] } }
operations.touch = { from = ["open"], to = "half" }
operations.complete = { from = ["half"], to = "all" }
operations.reinit = { from = ["*"], to = "open", rio = true }
"""  # noqa: E501
CYCLE = [
    ("registration", "plan"),
    ("digitization", "touch"),
    ("digitization", "complete"),
    ("registration", "register"),
    ("registration", "clear"),
]
NESTED: dict[str, Any] = {
    "initial": "empty",
    "states": [
        "empty",
        {"name": "planned", "initial": "open", "children": ["open", "half"]},
        "digitized",
        "registered",
    ],
    "transitions": [
        ["plan", "empty", "planned"],
        ["touch", "planned_open", "planned_half"],
        ["complete", "planned_half", "digitized"],
        ["register", "digitized", "registered"],
        ["clear", "registered", "empty"],
    ],
    "auto_transitions": False,
}
SISMIC = """
statechart:
  name: bench
  root state:
    name: root
    initial: empty
    states:
      - name: empty
        transitions: [{target: planned, event: plan}]
      - name: planned
        initial: open
        states:
          - name: open
            transitions: [{target: half, event: touch}]
          - name: half
            transitions: [{target: digitized, event: complete}]
      - name: digitized
        transitions: [{target: registered, event: register}]
      - name: registered
        transitions: [{target: empty, event: clear}]
"""

Send = Callable[[str, str], object]
AsyncSend = Callable[[str, str], Awaitable[object]]


class Chart(StateChart[Any]):
    """Machine for python-statemachine."""

    class planned(State.Compound):  # noqa: N801
        open = State(initial=True)
        half = State()
        touch = open.to(half)

    empty = State(initial=True)
    digitized = State()
    registered = State()
    plan = empty.to(planned)
    complete = planned.half.to(digitized)
    register = digitized.to(registered)
    clear = registered.to(empty)


class AsyncChart(Chart):
    """Machine with a coroutine, for which python-statemachine uses its asynchronous engine."""

    async def on_plan(self) -> None:
        """Do nothing."""


def bare() -> Send:
    """Return the limit: one dictionary without checks."""
    table = {
        ("empty", "plan"): "open",
        ("open", "touch"): "half",
        ("half", "complete"): "digitized",
        ("digitized", "register"): "registered",
        ("registered", "clear"): "empty",
    }
    state = ["empty"]

    def send(_branch: str, event: str) -> None:
        state[0] = table[state[0], event]

    return send


def engine() -> Send:
    """Return the engine of PCMRS."""
    return Engine(parse_blueprint(BLUEPRINT)).perform


def engine_without_cache() -> Send:
    """Return the engine as it behaves in a joint state without cached closures."""
    blueprint = parse_blueprint(BLUEPRINT)
    states = StateSet(blueprint)

    def send(branch: str, event: str) -> Change | Denial:
        answer = states.active(branch).ask(event)
        closure = answer if isinstance(answer, Denial) else close(blueprint, states.joint(), branch, event)
        if isinstance(closure, Denial):
            return closure
        (change,) = closure.outcomes.values()
        states.transition(change.targets)
        return change

    return send


def transitions_machine() -> Send:
    machine = HierarchicalMachine(**NESTED)
    return lambda _branch, event: getattr(machine, event)()


def python_statemachine() -> Send:
    chart = Chart()
    return lambda _branch, event: chart.send(event)


def sismic_interpreter() -> Send:
    interpreter = Interpreter(import_from_yaml(SISMIC))
    interpreter.execute()

    def send(_branch: str, event: str) -> None:
        interpreter.queue(event)
        interpreter.execute()

    return send


async def bare_async() -> AsyncSend:
    send = bare()

    async def asend(branch: str, event: str) -> object:
        return send(branch, event)

    return asend


class NullRecorder:
    """Recorder that stores nothing: the dispatcher without a journal."""

    def __init__(self) -> None:
        self._done: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._done.set_result(None)

    def intent(self, *_: Any) -> Awaitable[Any]:
        return self._done

    def decision(self, *_: Any, **__: Any) -> Awaitable[Any]:
        return self._done

    def event(self, *_: Any) -> Awaitable[Any]:
        return self._done

    def recall(self, *_: Any) -> None:
        return None


def dispatching(recorder: Any) -> AsyncSend:
    async def hold(_latch: bool) -> None:
        """There is no robot."""

    blueprint = parse_blueprint(BLUEPRINT)
    workflow: Workflow[Any, Any] = Workflow(
        blueprint, Registry(), ProcedureData(), lambda data, _states, _effects: data
    )
    dispatcher = Dispatcher(workflow, None, SystemClock(), recorder, hold)
    number = 0

    async def send(branch: str, event: str) -> object:
        nonlocal number
        number += 1
        return await dispatcher.submit(Command(id=str(number), branch=branch, operation=event, source="benchmark"))

    return send


async def dispatcher_without_journal() -> AsyncSend:
    return dispatching(NullRecorder())


async def transitions_async() -> AsyncSend:
    machine = HierarchicalAsyncMachine(**NESTED)

    async def send(_branch: str, event: str) -> object:
        return await getattr(machine, event)()

    return send


async def python_statemachine_async() -> AsyncSend:
    chart = AsyncChart()
    await chart.activate_initial_state()

    async def send(_branch: str, event: str) -> object:
        return await chart.send(event)

    return send


def measure(send: Send, events: int) -> list[float]:
    """Return the time of each event, µs.

    Args:
        send: Sends one event.
        events: Number of events.
    """
    times = []
    for number in range(events):
        branch, event = CYCLE[number % len(CYCLE)]
        begin = time.perf_counter_ns()
        send(branch, event)
        times.append((time.perf_counter_ns() - begin) / 1000.0)
    return times


async def measure_async(send: AsyncSend, events: int) -> list[float]:
    """Return the time of each event, µs.

    Args:
        send: Sends one event.
        events: Number of events.
    """
    times = []
    for number in range(events):
        branch, event = CYCLE[number % len(CYCLE)]
        begin = time.perf_counter_ns()
        await send(branch, event)
        await asyncio.sleep(0)  # work that is deferred to the next turn of the loop belongs to the event
        times.append((time.perf_counter_ns() - begin) / 1000.0)
    return times


def summary(name: str, times: Sequence[float], *, peer: bool) -> dict[str, Any]:
    """Return one row of the results.

    Args:
        name: Name of the library.
        times: Times, µs.
        peer: True for another library.
    """
    ordered = sorted(times)
    return {
        "name": name,
        "peer": peer,
        "events_per_s": round(1e6 * len(times) / sum(times)),
        "p50_us": round(median(ordered), 2),
        "p99_us": round(ordered[int(0.99 * len(ordered))], 2),
    }


async def run(rounds: int, events: int) -> dict[str, list[dict[str, Any]]]:
    """Measure all libraries in turn.

    Args:
        rounds: Number of rounds after the one that warms up.
        events: Number of events per round.
    """
    events -= events % len(CYCLE)
    peers = {"transitions", "python-statemachine", "sismic"}
    sync = {
        "bare dict": bare(),
        "PCMRS engine": engine(),
        "PCMRS engine, closures not cached": engine_without_cache(),
        "transitions": transitions_machine(),
        "python-statemachine": python_statemachine(),
        "sismic": sismic_interpreter(),
    }
    with tempfile.TemporaryDirectory() as folder:
        journal = Journal.open(Path(folder) / "journal.sqlite", durable=True)
        tag = BlueprintTag(id="bench", version="1", hash="0" * 64)
        recorder = JournalRecorder(journal, SystemClock(), "benchmark", tag)
        with_loop = {
            "bare dict": await bare_async(),
            "PCMRS dispatcher, no journal": await dispatcher_without_journal(),
            "PCMRS dispatcher, journal with fsync": dispatching(recorder),
            "transitions": await transitions_async(),
            "python-statemachine": await python_statemachine_async(),
        }
        times: dict[str, list[float]] = {name: [] for name in sync}
        async_times: dict[str, list[float]] = {name: [] for name in with_loop}
        for number in range(rounds + 1):  # the first warms up
            for name, send in sync.items():
                times[name] += measure(send, events) if number else measure(send, events)[:0]
            for name, asend in with_loop.items():
                measured = await measure_async(asend, events)
                async_times[name] += measured if number else []
        await journal.close()
    return {
        "sync": [summary(name, each, peer=name in peers) for name, each in times.items()],
        "async": [summary(name, each, peer=name in peers) for name, each in async_times.items()],
    }


def report(results: dict[str, list[dict[str, Any]]]) -> None:
    """Print the results."""
    print(f"Python {platform.python_version()}, {platform.machine()}; events per second, and µs per event")
    for kind, rows in results.items():
        fastest = max(row["events_per_s"] for row in rows if row["peer"])
        shortest = min(row["p50_us"] for row in rows if row["peer"])
        print(f"\n{kind:<40}{'events/s':>12}{'p50':>9}{'p99':>9}   against the fastest peer: events/s, p50")
        for row in rows:
            ratios = f"{row['events_per_s'] / fastest:>8.1f}{shortest / row['p50_us']:>8.1f}"
            print(f"{row['name']:<40}{row['events_per_s']:>12}{row['p50_us']:>9}{row['p99_us']:>9}{ratios}")


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=20)
    parser.add_argument("--events", type=int, default=500, help="per round")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    results = uvloop.run(run(arguments.rounds, arguments.events))
    print(json.dumps(results)) if arguments.json else report(results)


if __name__ == "__main__":
    main()
