"""The model of Stop keeps its promises in every interleaving, and breaks them without each of its rules."""

from __future__ import annotations

import re
import shutil
import subprocess
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest

from pcmrs.devices.gate import Gate
from pcmrs.errors import DeviceError
from pcmrs.messages import ActToken

MODEL = Path(__file__).with_name("stop.pml")
MISSING = [program for program in ("spin", "cc") if shutil.which(program) is None]

pytestmark = [
    pytest.mark.spin,
    pytest.mark.skipif(bool(MISSING), reason=f"{' and '.join(MISSING)} not installed: make spin"),
]

RULES = ("NO_EPOCH", "NO_SESSIONS", "NO_RELEASE_CHECK", "NO_PENDING", "NO_LOCK", "STAMPED_LATE")
MEMORY = "-DMEMLIM=3800"


def run(folder: Path, *command: str) -> str:
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0 or command[0] == "./pan", done.stdout + done.stderr
    return done.stdout


def search(folder: Path, *macros: str) -> str:
    """SPIN's search of the whole model; ends at the first broken promise."""
    shutil.copy(MODEL, folder)
    run(folder, "spin", "-a", *(f"-D{macro}" for macro in macros), MODEL.name)
    run(folder, "cc", "-O2", "-w", "-DSAFETY", "-DCOLLAPSE", MEMORY, "-o", "pan", "pan.c")
    found = run(folder, "./pan", "-m10000", "-w22", "-E")
    assert "Search not completed" not in found or "errors: 1" in found, found
    return found


@pytest.mark.timeout(300)
@pytest.mark.parametrize(
    "macros",
    [(), ("NO_CRASH", "NODE_HOLDS"), ("NO_CRASH", "TWO_ACKNOWLEDGEMENTS")],
    ids=lambda macros: " ".join(macros),
)
def test_every_interleaving_keeps_the_promises_of_stop(macros: tuple[str, ...], tmp_path: Path) -> None:
    found = search(tmp_path, *macros)
    assert "errors: 0" in found, found
    states = re.search(r"(\d+) states, stored", found)
    assert states is not None
    assert int(states[1]) > 100_000


@pytest.mark.parametrize("rule", RULES)
def test_without_a_rule_there_is_a_counterexample(rule: str, tmp_path: Path) -> None:
    found = search(tmp_path, rule)
    assert "assertion violated" in found, found


def test_motions_go_on_after_an_acknowledged_stop(tmp_path: Path) -> None:
    assert "assertion violated (confirmed==0)" in search(tmp_path, "REACHES")


STEP = re.compile(r"gate (hold|restart|release|admit) ([\d ]+?)(?: -> ([01]))?$", re.MULTILINE)
TRACES = 150


def replayed(trace: str) -> Iterator[tuple[str, bool, bool]]:
    """Each step of a trace on the code: its kind, whether the model took it, and whether the gate does."""
    gate = Gate("robot", "1")
    for kind, numbers, taken in STEP.findall(trace):
        values = [int(number) for number in numbers.split()]
        if kind == "restart":
            gate = Gate("robot", str(values[0]))
            yield kind, True, gate.state.latched
        elif kind == "hold":
            gate.hold(latch=True)
            yield (
                kind,
                True,
                (gate.state.node, gate.state.epoch, gate.state.latched) == (str(values[0]), values[1], True),
            )
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


def test_the_gate_does_what_the_model_does(tmp_path: Path) -> None:
    shutil.copy(MODEL, tmp_path)
    seen: Counter[tuple[str, bool]] = Counter()
    for seed in range(1, TRACES + 1):
        macros = ("-DNODE_HOLDS", "-DTWO_ACKNOWLEDGEMENTS")
        trace = run(tmp_path, "spin", f"-n{seed}", "-u2000", *macros, MODEL.name)
        for kind, model, code in replayed(trace):
            assert model == code, (seed, kind)
            seen[kind, model] += 1
    wanted = {(kind, taken) for kind in ("admit", "release") for taken in (False, True)}
    assert seen.keys() == {("hold", True), ("restart", True)} | wanted


@pytest.mark.parametrize("rule", ["NO_EPOCH", "NO_SESSIONS", "NO_RELEASE_CHECK"])
def test_the_gate_refuses_the_counterexamples_of_a_model_without_a_rule(rule: str, tmp_path: Path) -> None:
    search(tmp_path, rule)
    trace = run(tmp_path, "spin", "-t", f"-D{rule}", MODEL.name)
    steps = list(replayed(trace))
    assert [(kind, model, code) for kind, model, code in steps if model and not code], steps
