"""Under "More", operations are buttons by branch: possible ones send, others say why not; refusals stay in view."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from pcmrs.console._asking import Asking
from pcmrs.console._choices import Choice, Choices
from pcmrs.console._workflow import REFUSED, WorkflowPanel
from pcmrs.messages import BlueprintTag, DeviceEvent, Reason, Snapshot, Verdict
from tests.support.shipped import shipped_blueprint
from tests.unit.console.detached_page import ENGLISH, DetachedPage, Hands, ShownCell
from tests.unit.console.shown_cell import setup

BLUEPRINT = shipped_blueprint("ratms")
START = Snapshot(
    sequence=1, branches={name: next(iter(branch.states)) for name, branch in BLUEPRINT.branches.items()}, flags={},
    running=[], latched=False, blueprint=BlueprintTag(id="ratms", version="1", hash="0"),
)  # fmt: skip
CHOICES = Choices(BLUEPRINT, ENGLISH).all(START, setup())


class Sender:
    """Keeps what is sent, and answers with one verdict."""

    answer: Verdict | None = None

    def __init__(self) -> None:
        self.sent: list[tuple[str, Mapping[str, Any]]] = []

    async def ask(self, name: str, arguments: Mapping[str, Any]) -> Verdict | None:
        self.sent.append((name, arguments))
        return self.answer


def verdict(number: int, **changed: Any) -> Verdict:
    fields: dict[str, Any] = {"branch": "robot", "operation": "connect", "decision": "rejected", "state": "0"}
    fields["reason"] = Reason(code="busy", text=f"Reason {number}.")
    return Verdict(id=str(number), sequence=number, **fields | changed)


def panel(page: DetachedPage, view: ShownCell, sender: Any, **choices: Choice) -> WorkflowPanel:
    hands = Hands()
    with page.client:
        asking = Asking(view, setup(), sender, hands.actions)
        made = WorkflowPanel(view, setup(), BLUEPRINT, hands.actions, asking)
        made.refresh(START, {**CHOICES, **{each.name: each for each in choices.values()}})
    hands.look()
    return made


def test_branches_show_meanings_of_states_and_possible_buttons(page: DetachedPage) -> None:
    panel(page, ShownCell(), Sender())
    for name, choice in CHOICES.items():
        assert page.at(name).enabled == (not choice.why_not)
        assert page.text(name) == choice.title
    assert any(choice.why_not for choice in CHOICES.values())
    assert page.text("state-robot") == BLUEPRINT.branches["robot"].states[START.branches["robot"]]


async def test_a_possible_operation_is_sent_once(page: DetachedPage) -> None:
    sender = Sender()
    possible = next(each for each in CHOICES.values() if not each.why_not and each.payload == "none")
    panel(page, ShownCell(), sender)
    await page.press_around(possible.name)
    assert sender.sent == [(possible.name, {})]


async def test_an_impossible_operation_says_why_and_is_not_sent(page: DetachedPage) -> None:
    sender = Sender()
    impossible = next(each for each in CHOICES.values() if each.why_not)
    panel(page, ShownCell(), sender)
    await page.press_around(impossible.name)
    assert sender.sent == []
    assert page.notified == [impossible.why_not]


async def test_acknowledging_names_the_stop_that_is_shown(page: DetachedPage) -> None:
    """A newer Stop must not be acknowledged by somebody who has not seen it."""
    sender = Sender()
    panel(page, ShownCell(), sender, acknowledge=replace(CHOICES["robot.acknowledge"], why_not="", stop=7))
    await page.press_around("robot.acknowledge")
    assert sender.sent == [("robot.acknowledge", {"stop": 7})]


def test_only_the_last_refusals_of_people_are_shown_newest_first(page: DetachedPage) -> None:
    view = ShownCell()
    events: list[Verdict | DeviceEvent] = [verdict(number) for number in range(REFUSED + 2)]
    events.append(verdict(90, decision="accepted", reason=None))
    events.append(DeviceEvent(device="emg", code="noisy", text="It is noisy."))
    events.append(DeviceEvent(device="robot", code="link_lost", text="The link is cut.", danger=True))
    view.events.extend((float(number), event) for number, event in enumerate(events))
    panel(page, view, Sender())
    shown = page.text("refused").splitlines()
    assert shown[:2] == ["robot: link_lost", "The link is cut."]
    assert [line for line in shown if line.startswith("Reason")] == [
        f"Reason {number}." for number in range(REFUSED + 1, 2, -1)
    ]
