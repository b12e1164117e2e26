"""The model of Stop keeps its promises in every interleaving, and breaks them without each of its rules."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest

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
