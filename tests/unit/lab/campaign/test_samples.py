"""What a process takes is read rightly, and what grows is told from what only wavers."""

from __future__ import annotations

import os
import random
import threading
from typing import Any, cast

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from pcmrs.client import Client
from pcmrs.messages import BlueprintTag, Snapshot, Verdict
from pcmrs_lab.campaign.operating import RandomOperator
from pcmrs_lab.campaign.samples import sample, slope
from pcmrs_lab.campaign.soaking import ALLOWED, SoakReport, trend

TAG = BlueprintTag(id="ratms", version="1", hash="")
VALUES = st.lists(st.floats(-1e6, 1e6), min_size=3, max_size=50)


@given(values=VALUES)
def test_the_line_is_that_of_numpy(values: list[float]) -> None:
    times = [float(number) for number in range(len(values))]
    found, _ = slope(times, values)
    assert found == pytest.approx(np.polyfit(times, values, 1)[0], abs=1e-6 * (1 + max(map(abs, values))))


def test_descriptors_and_threads_are_counted() -> None:
    before = sample(os.getpid())
    reading, writing = os.pipe()
    end = threading.Event()
    thread = threading.Thread(target=end.wait)
    thread.start()
    after = sample(os.getpid())
    end.set()
    thread.join()
    os.close(reading)
    os.close(writing)
    assert after.descriptors == before.descriptors + 2
    assert after.threads == before.threads + 1
    assert after.memory > 0


@pytest.mark.parametrize("measure", ALLOWED)
@given(seed=st.integers(0, 100))
def test_wavering_course_is_flat_and_growing_one_is_not(measure: str, seed: int) -> None:
    generator = random.Random(seed)
    allowed = ALLOWED[measure]
    times = [float(number) for number in range(200)]
    wavering = [10 * allowed + generator.gauss(0.0, allowed / 4) for _ in times]
    growing = [value + 3 * allowed * time / times[-1] for time, value in zip(times, wavering, strict=True)]
    assert trend("daemon", measure, times, wavering).flat
    assert not trend("daemon", measure, times, growing).flat


def test_course_that_grows_only_during_warm_up_is_flat() -> None:
    times = [float(number) for number in range(100)]
    values = [1e8 + min(time, 15.0) * 4e6 for time in times]
    assert trend("daemon", "memory", times, values).flat


async def test_every_command_of_a_soak_has_its_own_id() -> None:
    """A repeated id gets the verdict of the first command, or is refused: nothing would be operated any more."""
    ids: list[str] = []

    class Cell:
        async def state(self) -> Snapshot:
            return Snapshot(sequence=1, branches={"robot": "0"}, flags={}, running=[], latched=False, blueprint=TAG)

        async def stop(self) -> None:
            pass

        async def call(self, name: str, arguments: dict[str, Any], *, id: str, timeout: float) -> Verdict:
            ids.append(id)
            branch, operation = name.split(".")
            return Verdict(id=id, branch=branch, operation=operation, decision="accepted", state="1", sequence=1)

    operator = RandomOperator(cast(Client, Cell()), random.Random(1))
    for _ in range(20):
        await operator.step()
        operator.verdicts.clear()
    assert len(ids) > 10
    assert len(set(ids)) == len(ids)


def test_soak_in_which_hardly_anything_is_accepted_fails() -> None:
    report = SoakReport(1.0, 1, 100, 0, {"accepted": 49, "rejected": 51}, 1, "", [])
    assert report.violated
    assert not replace(report, decisions={"accepted": 50, "rejected": 50}).violated
