"""Failpoints: nothing happens unless the process was armed, and arming needs a name that there is."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from pcmrs import failpoints
from pcmrs.errors import ConfigurationError
from pcmrs.failpoints import FAILPOINTS, ROTATION_FAILPOINTS, UPGRADE_FAILPOINTS, VARIABLE, arm, failpoint

PROGRAM = """
from pcmrs.failpoints import failpoint
for number in range(5):
    print(number, flush=True)
    failpoint("journal.after_head")
    failpoint("journal.before_begin")
"""


@pytest.fixture(autouse=True)
def disarmed() -> Iterator[None]:
    yield
    arm("")


def test_nothing_happens_if_unarmed_or_armed_for_another_place() -> None:
    for name in FAILPOINTS:
        failpoint(name)
    arm("journal.before_begin:2")
    for name in FAILPOINTS:
        failpoint(name)
    assert failpoints._armed is not None


def test_every_place_is_in_the_program_once() -> None:
    sources = Path(failpoints.__file__).parent.rglob("*.py")
    reached = [name for source in sources for name in re.findall(r'failpoint\("([a-z_.]+)"\)', source.read_text())]
    in_journal_both_ways = ["journal.before_acknowledge"]  # by the thread that commits, and at once
    everywhere = [*FAILPOINTS, *ROTATION_FAILPOINTS, *UPGRADE_FAILPOINTS]
    assert sorted(reached) == sorted([*everywhere, *in_journal_both_ways])


def test_an_armed_process_dies_at_the_time_that_was_named() -> None:
    armed = {**os.environ, VARIABLE: "journal.before_begin:3"}
    ended = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, timeout=60, env=armed)
    assert ended.returncode == -signal.SIGKILL
    assert ended.stdout.split() == ["0", "1", "2"]


@pytest.mark.parametrize(
    "text",
    ["journal", "journal.nowhere:1", "journal.after_head:0", "journal.after_head:-1", "journal.after_head:²", ":"],
)
def test_a_name_or_count_that_there_is_not_is_refused(text: str) -> None:
    with pytest.raises(ConfigurationError, match=VARIABLE):
        arm(text)
