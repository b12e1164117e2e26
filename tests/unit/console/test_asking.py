"""An operation is asked for at once, or after a form with its fields; no input is lost to a refusal."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import msgspec
from nicegui import core

from pcmrs.console._asking import Asking
from pcmrs.console._choices import Choice, Choices
from pcmrs.dispatcher.arguments import arguments_shown
from pcmrs.messages import BlueprintTag, Reason, Snapshot, Verdict
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

    async def ask(self, name: str, arguments: Mapping[str, Any]) -> Verdict | None:
        self.sent.append((name, arguments))
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
        view.data = data(touched)
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
    await page.press("send-form")
    assert sender.sent == []
    assert page.at("field-percent").error == ENGLISH("field_number")
    page.at("field-percent").set_value("60")
    await page.press("send-form")
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
    await page.press("send-form")
    assert page.at("field-percent").error == "stimulation.set_ceiling: too much."
    assert page.at("field-operator").value == "Dr Hand"
    await page.press("send-form")
    assert page.text("form-problem") == "Stop is latched."
    await page.press("send-form")
    await task
    assert len(sender.sent) == 3


async def test_a_press_as_the_form_opens_is_ignored(page: DetachedPage) -> None:
    """It is the second click of a double click on the button that has opened it."""
    sender = Sender()
    question = Question(page, CHOICES["placement.nudge"], sender)
    question.hands.look = lambda: None  # type: ignore[method-assign]
    task = await question.begin()
    await page.press("send-form")
    assert sender.sent == []
    question.hands.actions.dialogs.close_newest()
    await task
    assert sender.sent == []


async def test_a_nudge_is_typed_in_mm_and_degrees(page: DetachedPage) -> None:
    sender = Sender()
    task = await Question(page, CHOICES["placement.nudge"], sender).begin()
    page.at("field-translation").set_value("1 0 -2")
    await page.press("send-form")
    await task
    assert sender.sent == [("placement.nudge", {"translation": [0.001, 0.0, -0.002]})]


async def test_a_landmark_is_chosen_by_its_name(page: DetachedPage) -> None:
    sender = Sender()
    task = await Question(page, CHOICES["digitization.redigitize_one"], sender, touched=6).begin()
    chosen = page.at("which-landmark")
    assert chosen.options[1] == "2 of 6: left eye"
    chosen.set_value(1)
    await page.press("send-form")
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


async def test_a_retreat_without_registration_asks_to_look(page: DetachedPage) -> None:
    sender = Sender(Reason(code="body_not_registered", text="Nobody knows where the body is: look."))
    task = await Question(page, CHOICES["placement.home"], sender).begin()
    await page.press("looked")
    await task
    assert sender.sent == [("placement.home", {}), ("placement.home", {"confirm": True})]
