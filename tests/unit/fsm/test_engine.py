"""The engine decides by its state objects, and performs at once what they allow."""

from __future__ import annotations

import pytest

from pcmrs.fsm import (
    Change,
    Closure,
    Engine,
    StateSet,
    parse_blueprint,
)
from pcmrs.fsm.classes import source_of
from tests.support.shipped import shipped_blueprint
from tests.unit.fsm.level_workflow import THREE_LEVELS


def test_operation_without_steps_cannot_fail() -> None:
    engine = Engine(parse_blueprint(THREE_LEVELS))
    for ending in ("failed", "unknown", "elsewhere"):
        with pytest.raises(KeyError):
            engine.perform("top", "enter", ending)
    assert engine.joint() == parse_blueprint(THREE_LEVELS).initial()


RATMS = shipped_blueprint("ratms")


def test_allowed_lists_what_a_user_may_ask_for() -> None:
    engine = Engine(RATMS)
    assert engine.allowed("robot") == ["connect"]
    assert engine.perform("robot", "connect")
    assert engine.allowed("robot") == ["disconnect", "acknowledge"]
    assert RATMS.branches["robot"].operations["link_lost"].event
    assert isinstance(engine.ask("robot", "link_lost"), Closure)


def test_state_classes_decide_also_in_a_cascade(monkeypatch: pytest.MonkeyPatch) -> None:
    """One path: were a class changed, the engine would do as the class says, not as the blueprint says."""
    monkeypatch.setattr(StateSet, "_check_answers", lambda *_: None)
    source = source_of(RATMS).replace(
        """    def digitized(self) -> Answer:
        return self.DIGITIZED""",
        """    def digitized(self) -> Answer:
        return self.UNDIGITIZED""",
    )
    monkeypatch.setattr("pcmrs.fsm.classes.source_of", lambda _: source)
    engine = Engine(RATMS)
    engine.perform("registration", "plan_landmarks")
    change = engine.perform("digitization", "digitize_all")
    assert isinstance(change, Change)
    assert [(e.kind, e.branch, e.target) for e in change.effects][:2] == [
        ("operation", "digitization", "1"),
        ("signal", "registration", "100"),
    ]
