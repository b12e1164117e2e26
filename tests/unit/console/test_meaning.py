"""A button ignores presses until its new meaning was visible long enough to be meant."""

from __future__ import annotations

from pcmrs.console._meaning import SETTLING_TIME, ButtonMeaning


def test_a_double_click_never_presses_what_comes_next() -> None:
    now = 10.0
    button = ButtonMeaning(lambda: now)
    button.show("approach")
    now += 1.01 * SETTLING_TIME
    assert button.accepts("approach")
    button.show("confirm")
    assert not button.accepts("approach")
    assert not button.accepts("confirm")
    now += SETTLING_TIME / 2
    button.show("confirm")
    assert not button.accepts("confirm")
    now += 0.51 * SETTLING_TIME
    assert button.accepts("confirm")


def test_a_button_without_meaning_accepts_nothing() -> None:
    now = 0.0
    button = ButtonMeaning(lambda: now)
    now = 100.0
    assert not button.accepts("")
    button.show("")
    assert not button.accepts("approach")
