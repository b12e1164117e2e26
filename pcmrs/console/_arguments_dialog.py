"""Dialog for the arguments of an operation: one field for each, with its unit, limits, default and help."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from nicegui import ui

from pcmrs.console._action_button import PageActions
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
from pcmrs.console._command_sender import CommandSender
from pcmrs.console._meaning import ButtonMeaning
from pcmrs.messages.setup import ArgumentShown

Field = ui.input | ui.select | ui.checkbox


class ArgumentsDialog:
    """Form that stays open, with all its input, until the daemon has taken the arguments.

    Args:
        choice: The operation.
        arguments: Arguments to ask for.
        known: Arguments that are known already.
        sender: Sends commands to the daemon.
        actions: Shared parts of the page.

    Attributes:
        dialog: The dialog.
    """

    def __init__(
        self,
        choice: Choice,
        arguments: Sequence[ArgumentShown],
        known: Mapping[str, Any],
        sender: CommandSender,
        actions: PageActions,
    ) -> None:
        self._choice, self._known, self._sender, self._texts = choice, known, sender, actions.texts
        self._arguments = [each for each in arguments if each.kind != "other"]
        self._fields: dict[str, Field] = {}
        self._meaning = ButtonMeaning(actions.now)
        self._meaning.show(choice.name)
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
                    look = "deep-orange-9" if choice.moves else "primary"
                    label = texts("move_now" if choice.moves else "send")
                    ui.button(label, on_click=self._send, color=look).props('data-testid="send-form"')
                ui.button(texts("cancel"), on_click=lambda: self.dialog.submit(None)).props("flat")

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
        if not self._meaning.accepts(self._choice.name):
            return
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
        self._known_again()
        arguments = {**self._known, **given(values, self._arguments)}
        verdict = await self._sender.ask(self._choice.name, arguments)
        if verdict is None or (verdict.reason is not None and verdict.decision == "rejected"):
            text = "" if verdict is None or verdict.reason is None else verdict.reason.text
            name, text = refused_field(text, self._arguments)
            self._show_problem(text, name)
            return
        self.dialog.submit(True)

    def _known_again(self) -> None:
        """Remove the errors at all fields, which are being sent."""
        for field in self._fields.values():
            if isinstance(field, ui.input):
                field.error = None

    def _show_problem(self, text: str, name: str = "") -> None:
        field = self._fields.get(name)
        if isinstance(field, ui.input):
            field.error = text
        else:
            self._problem.set_text(text)
