"""Dialog for the arguments of an operation: one field for each, with its unit, limits, default and help."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

from nicegui import ui

from pcmrs.console._action_button import ActionButton, ButtonState, PageActions
from pcmrs.console._arguments import (
    FieldError,
    can_be_typed,
    default_text,
    given,
    label_with_unit,
    limits_text,
    refused_field,
    value_of,
)
from pcmrs.console._choices import Choice
from pcmrs.messages.setup import ArgumentShown

Field = ui.input | ui.select | ui.checkbox


class ArgumentsDialog:
    """Form that submits the arguments once they are valid, which closes it: it never covers what it has started.

    Args:
        choice: The operation.
        arguments: Arguments to ask for.
        actions: Shared parts of the page.
        earlier: Input of the same form before a refusal, by argument.
        problem: Text of that refusal; empty for none.

    Attributes:
        dialog: The dialog.
        typed: Input as it was submitted, by argument.
    """

    def __init__(
        self,
        choice: Choice,
        arguments: Sequence[ArgumentShown],
        actions: PageActions,
        earlier: Mapping[str, Any] = MappingProxyType({}),
        problem: str = "",
    ) -> None:
        self.typed: Mapping[str, Any] = {}
        self._texts = actions.texts
        self._arguments = [each for each in arguments if each.kind != "other"]
        self._fields: dict[str, Field] = {}
        texts = actions.texts
        with ui.dialog() as self.dialog, ui.card().classes("w-96"):
            ui.label(choice.title).classes("text-weight-bold")
            if can_be_typed(arguments):
                for argument in self._arguments:
                    self._fields[argument.name] = self._field(argument)
            else:
                ui.label(texts("not_typed"))
            self._problem = ui.label().classes("text-negative").props('data-testid="form-problem"')
            with ui.row():
                if can_be_typed(arguments):
                    send = ActionButton("send-form", actions, self._send, "")
                    label = texts("move_now" if choice.moves else "send")
                    send.refresh(ButtonState(label, choice.name, moves=choice.moves, confirms=True))
                ui.button(texts("cancel"), on_click=lambda: self.dialog.submit(None)).props("flat")
        for name, value in earlier.items():
            self._fields[name].set_value(value)
        name, text = refused_field(problem, self._arguments)
        self._show_problem(text, name)

    def _field(self, argument: ArgumentShown) -> Field:
        label, name = label_with_unit(argument), f'data-testid="field-{argument.name}"'
        if argument.kind == "yes_no":
            box = ui.checkbox(label, value=bool(argument.default)).props(name)
            with box:
                ui.tooltip(argument.help)
            return box
        if argument.kind == "choice":
            chosen = ui.select(argument.choices, label=label, value=default_text(argument) or None)
            return chosen.classes("w-full").props(name)
        text = ui.input(label, value=default_text(argument)).classes("w-full").props(name)
        hint = " ".join(filter(None, (argument.help, limits_text(argument, self._texts))))
        text.props["hint"] = hint
        return text

    async def _send(self) -> None:
        values: dict[str, Any] = {}
        self._show_problem("")
        for argument in self._arguments:
            field = self._fields[argument.name]
            typed = "" if field.value is None else str(field.value)
            try:
                values[argument.name] = value_of(argument, typed, self._texts)
            except FieldError as error:
                self._show_problem(error.text, argument.name)
        if len(values) < len(self._arguments):
            return
        self.typed = {name: field.value for name, field in self._fields.items()}
        self.dialog.submit(given(values, self._arguments))

    def _show_problem(self, text: str, name: str = "") -> None:
        field = self._fields.get(name)
        if isinstance(field, ui.input):
            field.error = text
        else:
            self._problem.set_text(text)
