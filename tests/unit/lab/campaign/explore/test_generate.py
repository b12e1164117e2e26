"""A seed draws one session: people mostly go on, and every fault comes up."""

from __future__ import annotations

from collections import Counter

import msgspec
import pytest

from pcmrs_lab.campaign.explore import generate
from pcmrs_lab.campaign.explore.faults import DETECTOR, FAULTS
from pcmrs_lab.campaign.explore.generate import FEWEST, MOST, MOST_EVENTS, OPERATORS, WATCHED, draw_script
from pcmrs_lab.campaign.explore.plans import GARBAGE
from pcmrs_lab.campaign.explore.script import SessionScript
from tests.unit.lab.blueprints import ratms

SESSIONS = 150


@pytest.fixture(scope="module")
def scripts() -> list[SessionScript]:
    return [draw_script(ratms(), "ratms", seed) for seed in range(SESSIONS)]


def test_a_seed_always_draws_the_same_session() -> None:
    assert draw_script(ratms(), "ratms", 9) == draw_script(ratms(), "ratms", 9)
    assert draw_script(ratms(), "ratms", 9).acts != draw_script(ratms(), "ratms", 10).acts
    assert draw_script(ratms(), "other", 9).acts != draw_script(ratms(), "ratms", 9).acts
    heavy = draw_script(ratms(), "ratms", 9, "mujoco")
    assert (heavy.physics, heavy.acts) == ("mujoco", draw_script(ratms(), "ratms", 9).acts)


def test_a_script_is_only_what_a_file_can_hold(scripts: list[SessionScript]) -> None:
    """JSON has no infinite numbers: a saved script that had one would be another script."""
    for script in scripts[:50]:
        assert msgspec.json.decode(msgspec.json.encode(script), type=SessionScript) == script


def test_every_fault_is_drawn(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(generate, "AIMED", 0.0)
    drawn = {act.what for seed in range(SESSIONS) for act in draw_script(ratms(), "ratms", seed).acts}
    assert {f"fault:{name}" for name in FAULTS} <= drawn


def test_a_share_of_the_sessions_aims_at_windows(scripts: list[SessionScript]) -> None:
    aimed = sum(any(act.window for act in script.acts) for script in scripts)
    assert aimed / SESSIONS == pytest.approx(generate.AIMED, abs=0.15)
    coded = sum(script.coded for script in scripts)
    assert coded / SESSIONS == pytest.approx(generate.CODED, abs=0.12)


def test_some_sessions_follow_the_head_and_the_others_stay(
    scripts: list[SessionScript], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(generate, "FOLLOWING", 0.0)
    changed = [script for script in scripts if script != draw_script(ratms(), "ratms", script.seed)]
    assert 0 < len(changed) < 0.12 * SESSIONS
    assert all(any(act.what == "placement.follow" for act in script.acts) for script in changed)


def test_people_mostly_go_on(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(generate, "AIMED", 0.0)
    scripts = [draw_script(ratms(), "ratms", seed) for seed in range(SESSIONS)]
    assert all(FEWEST <= len(script.acts) <= MOST + script.scene * MOST_EVENTS for script in scripts)
    acts = [act for script in scripts for act in script.acts]
    by_people = [act for act in acts if not act.what.startswith("fault:")]
    kinds = Counter(act.what for act in by_people)
    assert 0.6 < kinds["go_on"] / len(by_people) < 0.8
    assert {"stop", "repeat", "datagram"} < set(kinds)
    assert {act.who for act in by_people} == set(OPERATORS)
    assert {act.who for act in acts if act.what.startswith("fault:")} == {""}
    assert {act.arguments["number"] for act in acts if act.what == "datagram"} == set(range(len(GARBAGE)))


def test_a_fault_does_not_hold_up_people(scripts: list[SessionScript]) -> None:
    for act in (act for script in scripts for act in script.acts if act.what.startswith("fault:")):
        assert not act.waits
        assert ("lasts" in act.arguments) == ({**FAULTS, **DETECTOR}[act.what.removeprefix("fault:")].end is not None)


def test_what_detectors_see_comes_up_in_watched_scenes_only(scripts: list[SessionScript]) -> None:
    names = [(script.scene, act.what) for script in scripts for act in script.acts]
    of_detectors = {f"fault:{name}" for name in DETECTOR}
    assert {what for scene, what in names if what in of_detectors and scene} == of_detectors
    assert not {what for scene, what in names if what in of_detectors and not scene}
    assert 0.0 < sum(script.scene for script in scripts) / len(scripts) < 3 * WATCHED
