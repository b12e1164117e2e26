"""Timers in SCXML: a delayed event that is sent when a state is entered, and cancelled when that is left."""

from __future__ import annotations

from collections import defaultdict
from xml.etree.ElementTree import Element, SubElement

from pcmrs.authoring.exchange.exporting._events import commands
from pcmrs.authoring.exchange.exporting._reactions import Reaction
from pcmrs.fsm.blueprint import START_OUTCOME, Blueprint
from pcmrs.fsm.timers import duration


class ScxmlTimers:
    """Writer of the timers of a workflow into its chart.

    Args:
        blueprint: The workflow. A time that the configuration gives is written as the workflow's default.
    """

    def __init__(self, blueprint: Blueprint) -> None:
        self._blueprint = blueprint
        timed = [(name, key) for name, branch in blueprint.branches.items() for key in branch.timers]
        endings = commands(blueprint) if timed else ()
        self._events = {(each.branch, each.operation): each.event for each in endings if each.ending == START_OUTCOME}
        self._restarted: dict[str, list[tuple[str, str]]] = defaultdict(list)
        for name, key in timed:
            for operation in blueprint.branches[name].timers[key].begins_again(name):
                self._restarted[operation].append((name, key))

    def write_state(self, element: Element, branch: str, state: str) -> None:
        """Write what begins and ends the timers of a state.

        Args:
            element: Element of the state.
            branch: Name of the branch.
            state: The state.
        """
        timers = self._blueprint.branches[branch].timers_in(state)
        if timers:
            entry, end = SubElement(element, "onentry"), SubElement(element, "onexit")
            for key in timers:
                self._send(entry, branch, key)
                SubElement(end, "cancel", sendid=_id(branch, key))

    def write_transition(self, transition: Element, reaction: Reaction) -> None:
        """Write which timers a transition restarts: it then keeps the state of their branch.

        Args:
            transition: Element of the transition.
            reaction: The transition.
        """
        command = reaction.command
        operation = self._blueprint.branches[command.branch].operations[command.operation]
        # One of the transitions of a command is in the branch of the command: that one restarts.
        if reaction.branch != command.branch or command.ending in operation.unconfirmed:
            return
        for name, key in self._restarted.get(f"{command.branch}.{command.operation}", ()):
            states = self._blueprint.branches[name].timers[key].states
            if name != reaction.branch:
                condition = " || ".join(f"In('{name}.{state}')" for state in states)
                self._restart(SubElement(transition, "if", cond=condition), name, key)
            elif reaction.source in states and not reaction.entered:
                self._restart(transition, name, key)

    def _restart(self, above: Element, branch: str, key: str) -> None:
        SubElement(above, "cancel", sendid=_id(branch, key))
        self._send(above, branch, key)

    def _send(self, above: Element, branch: str, key: str) -> None:
        event = self._events[branch, self._blueprint.branches[branch].timers[key].posts]
        seconds = duration(self._blueprint, branch, key, {})
        SubElement(above, "send", id=_id(branch, key), event=event, delayexpr=f"'{seconds:g}s'")


def _id(branch: str, timer: str) -> str:
    return f"{branch}.{timer}"
