"""The panel for planning on the body's surface."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol, get_args

from nicegui import ui

from pcmrs.console._choices import Choice
from pcmrs.console._command_sender import CommandSender
from pcmrs.console._geometry import vertices_of
from pcmrs.console._live_feed import LiveFeed
from pcmrs.console.planning._canvas import Canvas
from pcmrs.console.planning._checking import PlanCheck, Requests
from pcmrs.console.planning._draft import Draft, Kind, as_arguments
from pcmrs.console.planning._forms import DraftEditor, GridForm, LandmarkForm, ToolForm, TrajectoryForm
from pcmrs.console.planning._upload_form import UploadForm
from pcmrs.console.texts import Texts
from pcmrs.fsm import Blueprint
from pcmrs.messages.setup import Setup
from pcmrs.registration.triangles import TriangleSurface
from pcmrs.spatial import Floats
from pcmrs.workflows.data import as_transform

NAMES: dict[Kind, tuple[str, str, str]] = {
    "landmarks": ("landmarks", "send_landmarks", "send-landmarks"),
    "tool_pose": ("tool", "send_tool", "send-tool"),
    "grid": ("grid", "send_grid", "send-grid"),
    "trajectory": ("trajectory", "send_trajectory", "send-trajectory"),
}
"""Keys of its name and of its button's text, and the button's ``data-testid``."""


class _Form(Protocol):
    """One kind of plan."""

    def pick(self, point: Floats) -> None:
        """Take a point of the surface that was clicked.

        Raises:
            GeometryError: It cannot be used.
        """

    def refresh(self) -> None:
        """Show the draft."""


class PlanningPanel:
    """A scene in the image's frame, with a plan that has not been sent yet.

    Args:
        feed: State of the cell.
        setup: Setup of the cell.
        blueprint: Workflow of the cell, whose operations define what can be planned.
        texts: Texts in the language of the page.
        sender: Sends commands to the daemon.
    """

    def __init__(self, feed: LiveFeed, setup: Setup, blueprint: Blueprint, texts: Texts, sender: CommandSender) -> None:
        self._sender, self._blueprint = sender, blueprint
        self._operations = operations(blueprint)
        draft = self._draft = Draft(
            surface=None if setup.surface is None else TriangleSurface(*vertices_of(setup.surface)),
            landmarks=list(feed.data.landmarks),
            pose=None if feed.data.plan is None else as_transform(feed.data.plan),
        )
        editor = self._editor = DraftEditor(draft, texts, self._changed)
        self._canvas = Canvas(setup, self._pick)
        self._mode = ui.toggle(
            {kind: texts(NAMES[kind][0]) for kind in self._operations},
            value=next(iter(self._operations), None),
            on_change=self._changed,
        )
        self._mode.props("dense no-caps").props('data-testid="mode"')
        self._forms: dict[Kind, _Form] = {}
        self._sending: dict[Kind, ui.button] = {}
        for kind in self._operations:
            with ui.column().classes("w-full gap-1").bind_visibility_from(self._mode, "value", value=kind):
                self._forms[kind] = self._build(kind, editor)
                button = ui.button(texts(NAMES[kind][1]), on_click=self._send).props("no-caps")
                self._sending[kind] = button.props(f'data-testid="{NAMES[kind][2]}"')
        self._checking = PlanCheck(feed, setup, texts)
        UploadForm(editor, self._canvas)
        self._changed()

    def _build(self, kind: Kind, editor: DraftEditor) -> _Form:
        match kind:
            case "landmarks":
                return LandmarkForm(editor)
            case "tool_pose":
                return ToolForm(editor, cortex="trajectory" not in self._operations)
            case "grid":
                return GridForm(editor)
            case "trajectory":
                return TrajectoryForm(editor)

    @property
    def _kind(self) -> Kind | None:
        """The kind of plan being edited; None in a workflow that takes no plan."""
        kind: Kind | None = self._mode.value
        return kind

    def _pick(self, point: Floats) -> None:
        if self._kind is not None:
            form = self._forms[self._kind]
            self._editor.do(lambda: form.pick(point))

    def refresh(self, choices: Mapping[str, Choice]) -> None:
        """Enable the operations that may be asked for, and check the plan again: its conditions may have changed."""
        for kind, button in self._sending.items():
            choice = choices.get(self._operations[kind])
            button.set_enabled(choice is not None and not choice.why_not)
        self._checking.check(self._requests())

    def choose(self, operation: str) -> None:
        """Choose the kind of plan that an operation takes; one that takes none changes nothing."""
        spec = self._blueprint.find(*operation.split("."))
        if spec is not None and spec.payload in self._operations:
            self._mode.set_value(spec.payload)

    def key(self, key: str) -> None:
        """Move the tool along the surface, or turn it; other keys have no effect."""
        if self._kind == "tool_pose":
            self._editor.do(lambda: self._draft.move(key))

    def _changed(self) -> None:
        kind = self._kind
        self._canvas.draw(self._draft, self._draft.guide if kind == "trajectory" else self._draft.pose)
        if kind is not None:
            self._forms[kind].refresh()
        self._checking.check(self._requests())

    def _requests(self) -> Requests:
        """Return the requests to check the plan; of a grid, one for every pose, too."""
        kind = self._kind
        arguments = None if kind is None else self._draft.arguments(kind)
        if kind is None or arguments is None:
            return []
        found = [(self._operations[kind], arguments)]
        if kind == "grid" and "tool_pose" in self._operations:
            found += [(self._operations["tool_pose"], as_arguments(pose)) for pose in self._draft.grid]
        return found

    async def _send(self) -> None:
        kind = self._kind
        arguments = None if kind is None else self._draft.arguments(kind)
        if kind is None or arguments is None:
            ui.notify(self._editor.texts("nothing_planned"), type="warning")
            return
        await self._sender.ask(self._operations[kind], arguments)


def operations(blueprint: Blueprint) -> dict[Kind, str]:
    """Return the operation for each kind of plan, in the order of `Kind`, for the kinds that a workflow has."""
    pairs = [
        (spec.payload, f"{branch}.{name}")
        for branch, each in blueprint.branches.items()
        for name, spec in each.operations.items()
        if not (spec.iio or spec.event)
    ]
    found = dict(reversed(pairs))  # the first of several operations for one payload
    return {kind: found[kind] for kind in get_args(Kind) if kind in found}
