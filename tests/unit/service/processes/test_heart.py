"""Signs of life: numbered in one session, never blocking, and a process that does not answer them is killed."""

from __future__ import annotations

import os
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any, cast

import pytest

from pcmrs.bus import BusSettings
from pcmrs.bus.heart import SIGN
from pcmrs.devices.node import DAEMON_BEAT
from pcmrs.messages import Beat
from pcmrs.processes.starting import start_by_exec
from pcmrs.service.processes.heart import ANSWER_TIME, STARTING_TIME, HeartProcess, LoopHeart
from pcmrs.testing.clock import ManualClock


class Hanging:
    """A heart whose process reads nothing and answers nothing."""

    def __init__(self) -> None:
        self.kills = 0
        self.reading, writing = os.pipe()
        os.set_blocking(writing, False)
        self.heart = HeartProcess(BusSettings(), ManualClock(), b"", start_by_exec)
        self.heart._pipe = writing
        self.heart._process = cast(Any, SimpleNamespace(kill=self._kill))

    def _kill(self) -> None:
        self.kills += 1


@pytest.fixture
def hanging() -> Iterator[Hanging]:
    made = Hanging()
    yield made
    made.heart._close_pipe()
    os.close(made.reading)


def test_signs_of_the_loop_are_numbered_beats_of_one_session() -> None:
    clock, published = ManualClock(), list[tuple[str, Beat]]()
    hearts = [LoopHeart(lambda key, beat: published.append((key, beat)), clock) for _ in range(2)]
    for _ in range(3):
        hearts[0].sign(clock.monotonic() - 0.01)
    assert {key for key, _ in published} == {DAEMON_BEAT}
    assert [beat.number for _, beat in published] == [1, 2, 3]
    assert {beat.session for _, beat in published} == {hearts[0].session}
    assert all(beat.sent - beat.alive == pytest.approx(0.01) for _, beat in published)
    assert hearts[0].session != hearts[1].session, "nodes tell a restarted daemon by it"


def test_signs_reach_the_process_whole_and_in_order(hanging: Hanging) -> None:
    for number in range(1, 4):
        hanging.heart.sign(number / 10)
    packed = os.read(hanging.reading, 4096)
    assert list(SIGN.iter_unpack(packed)) == [(1, 0.1), (2, 0.2), (3, 0.3)]


def test_full_or_broken_pipe_neither_blocks_nor_fails(hanging: Hanging) -> None:
    for _ in range(10_000):
        hanging.heart.sign(1.0)
    os.close(hanging.reading)
    hanging.heart.sign(1.0)
    hanging.reading = os.open(os.devnull, os.O_RDONLY)
    assert hanging.kills == 0, "no time has passed"


def test_process_may_start_slowly_and_then_must_answer(hanging: Hanging) -> None:
    hanging.heart.sign(0.0)
    hanging.heart.sign(STARTING_TIME)
    assert hanging.kills == 0
    hanging.heart.record_beat()
    hanging.heart.sign(200.0)
    hanging.heart.sign(200.0 + ANSWER_TIME)
    assert hanging.kills == 0
    hanging.heart.sign(200.0 + ANSWER_TIME + 0.01)
    assert hanging.kills == 1
    hanging.heart.sign(200.0 + ANSWER_TIME + 0.02)
    assert hanging.kills == 1, "the new one has its time"


def test_a_loop_that_was_silent_is_not_held_against_the_process(hanging: Hanging) -> None:
    hanging.heart.record_beat()
    hanging.heart.sign(0.0)
    hanging.heart.record_beat()
    hanging.heart.sign(100.0)
    assert hanging.kills == 0
