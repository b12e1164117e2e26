"""Check of the table of scene events against a workflow, before the cell starts."""

from __future__ import annotations

from collections.abc import Mapping

import msgspec

from pcmrs.errors import ConfigurationError
from pcmrs.fsm import Blueprint, OperationSpec
from pcmrs.scene.settings import SceneEventSettings


def check_scene_events(
    settings: SceneEventSettings, blueprint: Blueprint, payloads: Mapping[str, type[msgspec.Struct]]
) -> None:
    """Refuse a table that the workflow cannot serve, or by which a detector would move or treat.

    Args:
        settings: The table.
        blueprint: The workflow.
        payloads: Types of arguments by the names that the blueprint uses.

    Raises:
        ConfigurationError: An operation, state or argument does not exist, or a detector may not call the operation.
    """
    for where, name, arguments in settings.called():
        spec = _operation(where, name, blueprint)
        _check_harmless(where, name, spec)
        _check_arguments(where, name, arguments, payloads[spec.payload])
    for rule in settings.rules:
        for branch, states in rule.states.items():
            known = blueprint.branches[branch].states if branch in blueprint.branches else {}
            missing = [state for state in states if state not in known]
            if missing or not known:
                text = f"scene_events: the rule for {rule.label} names {branch} {', '.join(missing)}".rstrip()
                text += f", which {blueprint.id} does not have; {branch} has {', '.join(known) or 'no states'}."
                raise ConfigurationError(text, label=rule.label, branch=branch)


def _operation(where: str, name: str, blueprint: Blueprint) -> OperationSpec:
    branch, _, operation = name.partition(".")
    spec = blueprint.find(branch, operation)
    if spec is None:
        found = ((each, key, one) for each, its in blueprint.branches.items() for key, one in its.operations.items())
        events = [f"{each}.{key}" for each, key, one in found if one.event]
        text = f"scene_events: {where} calls {name}, which {blueprint.id} does not have; write stop or one of its "
        raise ConfigurationError(f"{text}event operations: {', '.join(events)}.", where=where, operation=name)
    return spec


def _check_harmless(where: str, name: str, spec: OperationSpec) -> None:
    """Nothing moves unasked, and nobody but a person acknowledges a Stop."""
    if not spec.event:
        text = f"scene_events: {where} calls {name}, which is for people: a detector may call event operations only."
        raise ConfigurationError(text, where=where, operation=name)
    if spec.moves or spec.affects_patient or spec.unlatches:
        text = f"scene_events: {where} calls {name}, which moves, treats or releases Stop: only people may."
        raise ConfigurationError(text, where=where, operation=name)


def _check_arguments(where: str, name: str, given: tuple[str, ...], payload: type[msgspec.Struct]) -> None:
    fields = {field.name: field.required for field in msgspec.structs.fields(payload)}
    unknown = [each for each in given if each not in fields]
    missing = [each for each, required in fields.items() if required and each not in given]
    if unknown or missing:
        found = f"does not take {', '.join(unknown)}" if unknown else f"needs {', '.join(missing)}"
        text = f"scene_events: {where} passes {', '.join(given) or 'no arguments'} to {name}, which {found}; "
        raise ConfigurationError(f"{text}it takes {', '.join(fields) or 'none'}.", where=where, operation=name)
