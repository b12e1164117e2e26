"""The next step of the procedure, as one button shows it. Pure; only the daemon decides."""

from __future__ import annotations

from collections.abc import Container, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from pcmrs.console._choices import Choice
from pcmrs.console.texts import Texts
from pcmrs.messages import NextStep, Running, Snapshot
from pcmrs.messages.setup import ProcedureDataView

Press = Literal["ask", "plan", "none"]
"""Effect of a press: the operation is asked for, planning is opened, or nothing."""

LANDMARK = "landmark_index"
"""Registered name of the arguments of operations on one landmark."""


@dataclass(frozen=True, slots=True)
class NextButton:
    """The large button, and the line below it.

    Attributes:
        press: Effect of a press.
        name: Operation that it stands for, ``branch.operation``; empty for none.
        label: Text of the button.
        why: Why it is next, what is missing, or what is waited for.
        enabled: A press would not be rejected, as far as a console can tell.
        moves: It moves the robot.
        arguments: Arguments that are known already.
        context: Context of the operation, as in `Choice`.
    """

    press: Press
    name: str
    label: str
    why: str
    enabled: bool = False
    moves: bool = False
    arguments: Mapping[str, Any] = field(default_factory=dict)
    context: str = ""

    @property
    def meaning(self) -> str:
        """What a press does; another text of the same effect is no other meaning."""
        return f"{self.press} {self.name} {dict(self.arguments)} {self.context}" if self.enabled else ""


def open_landmark(data: ProcedureDataView) -> int | None:
    """Return the index of the first landmark that is not digitized; None if there is none."""
    return next((index for index, each in enumerate(data.landmarks) if each.digitized is None), None)


def landmark_prompt(data: ProcedureDataView, index: int, texts: Texts) -> str:
    """Return which landmark is to be touched, such as "2 of 6: nose tip".

    Args:
        data: Data of the procedure.
        index: Index of the landmark.
        texts: Texts in the language of the page.
    """
    name = data.landmarks[index].name.replace("_", " ")
    return texts("landmark_prompt", number=index + 1, count=len(data.landmarks), name=name)


def next_button(
    found: NextStep,
    shown: Snapshot,
    choices: Mapping[str, Choice],
    data: ProcedureDataView,
    planned: Container[str],
    texts: Texts,
) -> NextButton:
    """Return the button for the next step.

    Args:
        found: The way on from the present states.
        shown: The present snapshot.
        choices: Operations by name.
        data: Data of the procedure.
        planned: Registered names of the arguments that are planned on the surface.
        texts: Texts in the language of the page.
    """
    if shown.running:
        return NextButton("none", "", texts("next_running"), _running(shown.running[0], choices, texts))
    if not found.next:
        return NextButton("none", "", texts("next_done" if not found.stage else "next_stuck"), found.why)
    stage = next((each.title for each in found.stages if each.id == found.stage), "")
    if found.awaited:
        return NextButton("none", found.next, texts("next_wait"), texts("next_wait_why", stage=stage, name=found.next))
    choice = choices[found.next]
    label, arguments = choice.title, dict[str, Any]()
    if choice.stop is not None:
        label, arguments = texts("release_stop", stop=choice.stop), {"stop": choice.stop}
    index = open_landmark(data)
    if choice.payload == LANDMARK and index is not None:
        label, arguments = texts("touch_landmark", which=landmark_prompt(data, index, texts)), {"index": index}
    why = choice.why_not or (texts("next_why", stage=stage) if stage else texts("next_release"))
    press: Press = "plan" if choice.payload in planned else "ask"
    return NextButton(press, found.next, label, why, not choice.why_not, choice.moves, arguments, choice.context)


def _running(running: Running, choices: Mapping[str, Choice], texts: Texts) -> str:
    """Return what a person is to touch, or what runs and how far it is."""
    prompt = running.prompt
    if prompt is not None and prompt.landmark:
        name = prompt.landmark.replace("_", " ")
        which = texts("landmark_prompt", number=prompt.number, count=prompt.count, name=name)
        return texts("touch_landmark", which=which)
    if prompt is not None:
        return prompt.text
    choice = choices.get(f"{running.branch}.{running.operation}")
    title = running.operation if choice is None else choice.title
    return texts("progress", name=title, percent=100.0 * running.progress)
