"""An operation is asked for at once, or after a form with its fields; no input is lost to a refusal."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import msgspec
import pytest
from nicegui import core

from pcmrs.console._asking import Asking
from pcmrs.console._choices import Choice, Choices
from pcmrs.console._press import beat_of
from pcmrs.dispatcher.arguments import arguments_shown
from pcmrs.messages import BlueprintTag, Reason, Snapshot, StopState, Verdict
from pcmrs.testing.clock import settle
from tests.support.shipped import shipped_workflow
from tests.unit.console.detached_page import ENGLISH, DetachedPage, Hands, ShownCell
from tests.unit.console.shown_cell import setup
from tests.unit.console.test_next import data

WORKFLOW = shipped_workflow("ratms_threshold")
BLUEPRINT = WORKFLOW.blueprint
SETUP = msgspec.structs.replace(setup(), arguments=arguments_shown(WORKFLOW.registry.payloads))
START = Snapshot(
    sequence=1, branches=BLUEPRINT.initial(), flags={}, running=[], latched=False,
    blueprint=BlueprintTag(id="ratms_threshold", version="1", hash="0"),
)  # fmt: skip
CHOICES = Choices(BLUEPRINT, ENGLISH).all(START, SETUP)


class Sender:
    """Keeps what is sent, and rejects it for the given reasons first."""

    def __init__(self, *reasons: Reason) -> None:
        self.sent: list[tuple[str, Mapping[str, Any]]] = []
        self.reasons = [*reasons]
        self.is_silent = False
        self.answers = asyncio.Event()
        self.answers.set()

    async def ask(self, name: str, arguments: Mapping[str, Any]) -> Verdict | None:
        self.sent.append((name, arguments))
        await self.answers.wait()
        if self.is_silent:
            return None
        reason = self.reasons.pop(0) if self.reasons else None
        branch, _, operation = name.partition(".")
        decision: Any = "accepted" if reason is None else "rejected"
        return Verdict(
            id="1", branch=branch, operation=operation, decision=decision, state="", sequence=1, reason=reason
        )


class Question:
    """One operation that a person asks for on a page."""

    def __init__(self, page: DetachedPage, choice: Choice, sender: Sender, touched: int = 0) -> None:
        self.page, self.hands = page, Hands()
        view, to_daemon = ShownCell(), sender
        view.data, view.snapshot = data(touched), START
        self.view = view
        served: Any = to_daemon
        self.asking = Asking(view, SETUP, served, self.hands.actions)
        self.choice = choice

    async def begin(self, **known: Any) -> asyncio.Task[None]:
        core.loop = asyncio.get_running_loop()

        async def ask() -> None:
            with self.page.client:
                await self.asking.ask(self.choice, known)

        task = asyncio.create_task(ask())
        await settle()
        self.hands.look()
        return task


async def test_what_needs_no_arguments_is_sent_at_once(page: DetachedPage) -> None:
    sender = Sender()
    await (await Question(page, CHOICES["robot.connect"], sender).begin())
    await (await Question(page, replace(CHOICES["robot.acknowledge"], stop=7), sender).begin())
    await (await Question(page, CHOICES["digitization.digitize_one"], sender).begin(index=2))
    assert sender.sent == [
        ("robot.connect", {}), ("robot.acknowledge", {"stop": 7}), ("digitization.digitize_one", {"index": 2}),
    ]  # fmt: skip


async def test_an_invalid_field_is_marked_and_nothing_is_sent(page: DetachedPage) -> None:
    sender = Sender()
    question = Question(page, CHOICES["stimulation.set_ceiling"], sender)
    task = await question.begin()
    page.at("field-operator").set_value("Dr Hand")
    page.at("field-percent").set_value("much")
    await page.press_around("send-form")
    assert sender.sent == []
    assert page.at("field-percent").error == ENGLISH("field_number")
    page.at("field-percent").set_value("60")
    await page.press_around("send-form")
    await task
    assert sender.sent == [("stimulation.set_ceiling", {"percent": 60.0, "operator": "Dr Hand"})]
    assert not question.hands.actions.dialogs


async def test_input_stays_after_a_refusal_which_is_at_its_field(page: DetachedPage) -> None:
    refused = Reason(code="bad_arguments", text="stimulation.set_ceiling: too much - at `$.percent`.")
    sender = Sender(refused, Reason(code="latched", text="Stop is latched."))
    question = Question(page, CHOICES["stimulation.set_ceiling"], sender)
    task = await question.begin()
    page.at("field-operator").set_value("Dr Hand")
    page.at("field-percent").set_value("99")
    await page.press_around("send-form")
    assert page.at("field-percent").error == "stimulation.set_ceiling: too much."
    assert page.at("field-operator").value == "Dr Hand"
    question.hands.look()
    await page.press_around("send-form")
    assert page.text("form-problem") == "Stop is latched."
    question.hands.look()
    await page.press_around("send-form")
    await task
    assert len(sender.sent) == 3


async def test_a_press_as_the_form_opens_is_ignored(page: DetachedPage) -> None:
    """It is the second click of a double click on the button that has opened it."""
    sender = Sender()
    question = Question(page, CHOICES["placement.nudge"], sender)
    question.hands.look = lambda: None  # type: ignore[method-assign]
    task = await question.begin()
    await page.press_around("send-form")
    assert sender.sent == []
    question.hands.actions.dialogs.close_newest()
    await task
    assert sender.sent == []


async def test_a_nudge_is_typed_in_mm_and_degrees(page: DetachedPage) -> None:
    sender = Sender()
    task = await Question(page, CHOICES["placement.nudge"], sender).begin()
    page.at("field-translation").set_value("1 0 -2")
    await page.press_around("send-form")
    await task
    assert sender.sent == [("placement.nudge", {"translation": [0.001, 0.0, -0.002]})]


async def test_a_landmark_is_chosen_by_its_name(page: DetachedPage) -> None:
    sender = Sender()
    question = Question(page, CHOICES["digitization.redigitize_one"], sender, touched=6)
    task = await question.begin()
    chosen = page.at("which-landmark")
    assert chosen.options[1] == "2 of 6: left eye"
    chosen.set_value(1)
    question.hands.look()
    await page.press_around("send-form")
    await task
    assert sender.sent == [("digitization.redigitize_one", {"index": 1})]


async def test_a_plan_is_not_typed_into_a_form(page: DetachedPage) -> None:
    sender = Sender()
    question = Question(page, CHOICES["registration.plan_landmarks"], sender)
    task = await question.begin()
    assert page.says(ENGLISH("not_typed"))
    question.hands.actions.dialogs.close_newest()
    await task
    assert sender.sent == []


async def test_a_form_is_closed_while_its_command_runs(page: DetachedPage) -> None:
    """It would cover the motion that it has started, and a double click would send it twice."""
    sender = Sender()
    sender.answers.clear()
    question = Question(page, CHOICES["placement.nudge"], sender)
    task = await question.begin()
    send = page.at("send-form").parent_slot.parent
    press = {"meaning": "placement.nudge", "beat": beat_of(question.hands.now)}
    await page.happen(send, "click", press, press)
    assert (len(sender.sent), bool(question.hands.actions.dialogs)) == (1, False)
    sender.answers.set()
    await task
    assert len(sender.sent) == 1


async def test_a_form_of_unknown_outcome_is_not_repeated(page: DetachedPage) -> None:
    sender = Sender()
    sender.is_silent = True
    question = Question(page, CHOICES["placement.nudge"], sender)
    task = await question.begin()
    await page.press_around("send-form")
    assert not question.hands.actions.dialogs
    await task


async def test_a_form_for_a_motion_to_another_plan_is_void(page: DetachedPage) -> None:
    sender = Sender()
    question = Question(page, CHOICES["placement.nudge"], sender)
    task = await question.begin()
    question.view.snapshot = msgspec.structs.replace(START, plan="another")
    await page.press_around("send-form")
    await task
    assert (sender.sent, page.notified) == ([], [ENGLISH("changed")])


UNREGISTERED = Reason(code="body_not_registered", text="Nobody knows where the body is: look.")


async def test_a_retreat_without_registration_asks_to_look(page: DetachedPage) -> None:
    sender = Sender(UNREGISTERED)
    question = Question(page, CHOICES["placement.home"], sender)
    question.hands.look, look = (lambda: None), question.hands.look  # type: ignore[method-assign]
    task = await question.begin()
    await page.hold("looked")
    assert len(sender.sent) == 1, "it has just appeared"
    look()
    await page.press_around("looked")
    assert len(sender.sent) == 1, "a click moves nothing"
    await page.hold("looked")
    await task
    assert sender.sent == [("placement.home", {}), ("placement.home", {"confirm": True})]


@pytest.mark.parametrize(
    "changed",
    [{"branches": START.branches | {"placement": "held"}}, {"stop": StopState(number=1)}, {"registration": "another"}],
    ids=["placement", "stop", "registration"],
)
async def test_a_look_from_before_a_change_is_void(page: DetachedPage, changed: dict[str, Any]) -> None:
    sender = Sender(UNREGISTERED)
    question = Question(page, CHOICES["placement.home"], sender)
    task = await question.begin()
    question.view.snapshot = msgspec.structs.replace(START, **changed)
    await page.hold("looked")
    await task
    assert (sender.sent, page.notified) == ([("placement.home", {})], [ENGLISH("changed")])
