"""What moves the arm needs a hold or a confirmation, and no button acts by a double click."""

from __future__ import annotations

import pytest
from nicegui import ui

from pcmrs.console._action_button import ActionButton, ButtonState
from pcmrs.console._press import LATE
from tests.unit.console.detached_page import ENGLISH, DetachedPage, Hands

ASK = ButtonState("Register", "register")
MOVE = ButtonState("Approach", "approach", moves=True)


class Act:
    """Counts what a button does."""

    def __init__(self) -> None:
        self.count = 0

    async def __call__(self) -> None:
        self.count += 1


def made(page: DetachedPage, hands: Hands, state: ButtonState) -> tuple[ActionButton, Act]:
    act = Act()
    with page.client:
        button = ActionButton("it", hands.actions, act, "dense")
        button.refresh(state)
    return button, act


async def test_a_click_acts_once_the_button_has_settled(page: DetachedPage) -> None:
    hands = Hands()
    button, act = made(page, hands, ASK)
    await page.press_around("it")
    assert act.count == 0
    hands.look()
    await page.press_around("it")
    assert act.count == 1
    button.refresh(MOVE)
    await page.press_around("it")
    button.refresh(ASK)
    await page.press_around("it")
    assert act.count == 1


async def test_a_motion_is_held_and_a_click_does_nothing(page: DetachedPage) -> None:
    hands = Hands("hold")
    _, act = made(page, hands, MOVE)
    await page.hold("it")
    assert act.count == 0
    hands.look()
    await page.press_around("it")
    assert act.count == 0
    await page.hold("it")
    assert act.count == 1
    await page.hold("it", "confirm")
    assert act.count == 1, "it was pressed when it meant something else"


async def test_only_what_moves_can_be_held(page: DetachedPage) -> None:
    hands = Hands("hold")
    _, act = made(page, hands, ASK)
    hands.look()
    await page.hold("it")
    await page.hold("it", "register")
    assert act.count == 0


@pytest.mark.parametrize("settled", [True, False])
async def test_a_motion_is_confirmed_in_a_dialog(page: DetachedPage, settled: bool) -> None:
    hands = Hands("confirm")
    _, act = made(page, hands, MOVE)
    hands.look()
    await page.hold("it", "approach")
    await page.press_around("it")
    assert act.count == 0
    assert page.says(ENGLISH("moves_arm"))
    if settled:
        hands.look()
    await page.press_around("move-now")
    assert act.count == settled
    assert bool(hands.actions.dialogs) == (not settled)
    hands.actions.dialogs.close_newest()


async def test_a_confirmation_of_another_meaning_is_worth_nothing(page: DetachedPage) -> None:
    hands = Hands("confirm")
    button, act = made(page, hands, MOVE)
    hands.look()
    await page.press_around("it")
    button.refresh(ButtonState("Confirm", "confirm", moves=True))
    hands.look()
    await page.press_around("move-now")
    assert act.count == 0


async def test_a_disabled_button_says_why(page: DetachedPage) -> None:
    hands = Hands()
    _, act = made(page, hands, ButtonState("Approach", "", why_not="Not registered.", moves=True))
    hands.look()
    assert not page.at("it").enabled
    await page.press_around("it")
    await page.hold("it", "")
    assert (act.count, page.notified) == (0, ["Not registered."])
    assert isinstance(page.at("it"), ui.button)


async def test_a_click_counts_for_the_meaning_at_the_press(page: DetachedPage) -> None:
    hands = Hands()
    _, act = made(page, hands, ASK)
    hands.look()
    await page.press_around("it", "plan")
    await page.press_around("it", "")
    assert act.count == 0
    await page.press_around("it", "register")
    assert act.count == 1


async def test_a_late_press_does_nothing_and_says_so(page: DetachedPage) -> None:
    hands = Hands("hold")
    button, act = made(page, hands, MOVE)
    hands.look()
    await page.hold("it", age=LATE + 0.01)
    button.refresh(ASK)
    hands.look()
    await page.press_around("it", age=15.0)
    assert (act.count, page.notified) == (0, [ENGLISH("late_press")] * 2)
    await page.press_around("it", age=0.9)
    assert act.count == 1


async def test_a_late_confirmation_is_worth_nothing(page: DetachedPage) -> None:
    hands = Hands("confirm")
    _, act = made(page, hands, MOVE)
    hands.look()
    await page.press_around("it")
    hands.look()
    await page.press_around("move-now", age=15.0)
    assert act.count == 0
    await page.press_around("move-now")
    assert act.count == 1
