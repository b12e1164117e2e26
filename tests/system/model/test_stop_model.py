"""The model of Stop keeps its promises in every interleaving, and breaks them without each of its rules."""

from __future__ import annotations

import asyncio
import re
import shutil
import subprocess
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from pkgutil import resolve_name
from tempfile import TemporaryDirectory

import pytest

from pcmrs.devices.gate import Gate
from pcmrs.errors import DeviceError
from pcmrs.messages import ActToken
from pcmrs.simulated_time.loop import SimulatedLoop
from pcmrs.workflows.cell import Cell
from tests.system.model.stop_replay import first_difference, make_cell

MODEL = Path(__file__).with_name("stop.pml")
MISSING = [program for program in ("spin", "cc", "tcc") if shutil.which(program) is None]

pytestmark = [
    pytest.mark.spin,
    pytest.mark.skipif(bool(MISSING), reason=f"{' and '.join(MISSING)} not installed: make spin"),
]

RULES = ("NO_EPOCH", "NO_SESSIONS", "NO_RELEASE_CHECK", "NO_PENDING", "NO_LOCK", "STAMPED_LATE")
RULES_OF_THE_GATE = ("NO_EPOCH", "NO_SESSIONS", "NO_RELEASE_CHECK")
MEMORY = "-DMEMLIM=3800"


def run(folder: Path, *command: str) -> str:
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0 or command[0] == "./pan", done.stdout + done.stderr
    return done.stdout


FAST = ("cc", "-O2")
SOON = ("tcc",)
"""Compilers of a search: of one that takes long, and of one that soon ends, which would take longer to optimize."""


def search(folder: Path, *macros: str, compiler: Sequence[str] = SOON) -> str:
    """SPIN's search of the whole model; ends at the first broken promise."""
    shutil.copy(MODEL, folder)
    run(folder, "spin", "-a", *(f"-D{macro}" for macro in macros), MODEL.name)
    run(folder, *compiler, "-w", "-DSAFETY", "-DCOLLAPSE", MEMORY, "-o", "pan", "pan.c")
    found = run(folder, "./pan", "-m10000", "-w22", "-E")
    assert "Search not completed" not in found or "errors: 1" in found, found
    return found


@pytest.mark.timeout(300)
@pytest.mark.parametrize(
    "macros", [(), ("NODE_HOLDS",), ("TWO_ACKNOWLEDGEMENTS",)], ids=lambda macros: " ".join(macros)
)
def test_every_interleaving_keeps_the_promises_of_stop(macros: tuple[str, ...], tmp_path: Path) -> None:
    found = search(tmp_path, *macros, compiler=FAST if macros else SOON)
    assert "errors: 0" in found, found
    states = re.search(r"(\d+) states, stored", found)
    assert states is not None
    assert int(states[1]) > 100_000


def test_motions_are_possible_after_an_acknowledged_stop(tmp_path: Path) -> None:
    assert "assertion violated (confirmed==0)" in search(tmp_path, "REACHES")


STEP = re.compile(r"gate (hold|end|restart|release|admit) ([\d ]+?)(?: -> ([01]))?$", re.MULTILINE)
TRACES = 60
REPLAYED = 25
"""As many of them are replayed on the whole daemon when nothing is wrong: they show every step there is."""


@pytest.fixture(scope="module")
def traces(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """Random traces of the model, as SPIN prints them."""
    folder = tmp_path_factory.mktemp("traces")
    shutil.copy(MODEL, folder)
    macros = ("-DSTEPS", "-DNODE_HOLDS", "-DTWO_ACKNOWLEDGEMENTS")
    return [
        run(folder, "spin", "-T", f"-n{seed}", "-u4000", f"-DDELAY={2 + seed % 4}", *macros, MODEL.name)
        for seed in range(TRACES)
    ]


def replayed(trace: str) -> Iterator[tuple[str, bool, bool]]:
    """Each step of a trace on the code: its kind, whether the model took it, and whether the gate does."""
    gate = Gate("robot", "1")
    for kind, numbers, taken in STEP.findall(trace):
        values = [int(number) for number in numbers.split()]
        if kind == "restart":
            gate = Gate("robot", str(values[0]))
            yield kind, True, gate.state.latched
        elif kind in ("hold", "end"):
            latched = kind == "hold" or gate.state.latched
            gate.hold(latch=kind == "hold")
            state = gate.state
            yield kind, True, (state.node, state.epoch, state.latched) == (str(values[0]), values[1], latched)
        else:
            daemon, node, epoch, *count = values
            token = ActToken(daemon=str(daemon), node=str(node), epoch=epoch, number=sum(count))
            yield kind, taken == "1", takes(gate, kind, token)


def takes(gate: Gate, kind: str, token: ActToken) -> bool:
    try:
        (gate.admit if kind == "admit" else gate.release)(token)
    except DeviceError:
        return False
    return True


def test_the_gate_does_what_the_model_does(traces: list[str]) -> None:
    seen: Counter[tuple[str, bool]] = Counter()
    for trace in traces:
        for kind, model, code in replayed(trace):
            assert model == code, (kind, trace)
            seen[kind, model] += 1
    wanted = {(kind, taken) for kind in ("admit", "release") for taken in (False, True)}
    assert seen.keys() == {("hold", True), ("end", True), ("restart", True)} | wanted


@pytest.fixture(scope="module")
def cell() -> Cell:
    return make_cell()


def on_the_daemon(trace: str, folder: Path, cell: Cell) -> str | None:
    """Where the daemon's side first does something else than a trace; see `stop_replay`."""
    with TemporaryDirectory(dir=folder) as own, asyncio.Runner(loop_factory=SimulatedLoop) as runner:
        return runner.run(first_difference(trace, Path(own) / "journal.sqlite", cell))


@pytest.mark.timeout(300)
def test_the_daemon_does_what_the_model_does(traces: list[str], tmp_path: Path, cell: Cell) -> None:
    seen: Counter[str | tuple[str, ...]] = Counter()
    for trace in traces[:REPLAYED]:
        assert on_the_daemon(trace, tmp_path, cell) is None, trace
        seen.update(re.findall(r"^step (\w+)", trace, re.MULTILINE))
        seen.update(re.findall(r"^gate (\w+ )[\d ]+(-> [01])$", trace, re.MULTILINE))
        seen.update(re.findall(r"^step crash\nstate 0 [01]", trace, re.MULTILINE))
    begun = {"connect", "acknowledge", "end", "ended", "release", "released"}
    moved = {"motion", "request", "arrive", "done", "committed", "failed"}
    stopped = {"stop", "hold", "held", "event", "decided", "beat", "deadman", "restart", "crash"}
    answers = {(kind, f"-> {taken}") for kind in ("admit ", "release ") for taken in (0, 1)}
    assert seen.keys() == begun | moved | stopped | answers | {f"step crash\nstate 0 {latched}" for latched in (0, 1)}


@pytest.mark.parametrize("rule", RULES)
def test_model_without_a_rule_fails_where_the_code_does_not(rule: str, tmp_path: Path, cell: Cell) -> None:
    """There is a counterexample that the code does not follow."""
    assert "assertion violated" in search(tmp_path, rule, "STEPS")
    trace = run(tmp_path, "spin", "-T", "-t", f"-D{rule}", "-DSTEPS", MODEL.name)
    refused = any(model and not code for _, model, code in replayed(trace))
    assert refused == (rule in RULES_OF_THE_GATE), trace
    assert on_the_daemon(trace, tmp_path, cell) is not None, trace


def nothing(*_: object, **__: object) -> None:
    return None


def never(*_: object) -> bool:
    return False


DEFECTS: dict[str, tuple[str, Callable[..., object]]] = {
    "the gate takes whatever comes": ("pcmrs.devices.gate:Gate.check", lambda _, token: token),
    "a release is not checked": (
        "pcmrs.devices.gate:Gate.release",
        lambda gate, token: gate._change(epoch=gate.state.epoch, latched=False, daemon=token.daemon),
    ),
    "an acknowledgement is never refused": ("pcmrs.dispatcher.stops:Stops.objection", nothing),
    "Stop ends no motion": ("pcmrs.dispatcher.locks:PendingCommand.stop", nothing),
    "nothing is locked": ("pcmrs.dispatcher.locks:Locks.conflicts", never),
    "what a beat says of a latch is not looked at": ("pcmrs.service.watches.gates:GateWatch._compare", nothing),
    "a motion that was under way latches nothing after a crash": (
        "pcmrs.service.restart.state:RestartState._add_unknown_outcome",
        nothing,
    ),
    "nothing follows from danger": (
        "pcmrs.dispatcher.stops:StopControl.follow_danger",
        lambda _, submit: submit(),
    ),
}
"""What is wrong, to the function in whose place the defective one is put."""


@pytest.mark.parametrize("defect", DEFECTS)
def test_the_replay_shows_a_defect(
    defect: str, traces: list[str], tmp_path: Path, cell: Cell, monkeypatch: pytest.MonkeyPatch
) -> None:
    name, defective = DEFECTS[defect]
    owner, _, attribute = name.rpartition(".")
    monkeypatch.setattr(resolve_name(owner), attribute, defective)
    assert any(on_the_daemon(trace, tmp_path, cell) for trace in traces)
