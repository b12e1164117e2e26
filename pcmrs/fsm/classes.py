"""Python source of the branch and state classes of a blueprint, and the classes that it defines.

The dispatcher only asks classes that were generated as source and then executed: there is no other path. Texts
of a blueprint get into it as string literals only, its names only after `pcmrs.fsm.rules.names` has accepted them.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from functools import cache, lru_cache
from types import CodeType
from typing import Any

import msgspec

from pcmrs.fsm._state import State
from pcmrs.fsm.blueprint import ActivitySpec, Blueprint, BranchSpec, OperationSpec, TimerSpec

RESERVED = frozenset(name for name in dir(State) if not name.startswith("_")) | {"active", "self"}
"""Names that an operation or branch cannot have: the state classes use them."""

LINE = 120
"""Longest line, in characters, of a table that is written on one line."""


def class_name(branch: str) -> str:
    """Return the name of a branch's class: ``tool_plan`` is ``ToolPlanBranch``."""
    return "".join(word.capitalize() for word in branch.split("_")) + "Branch"


def states_of(blueprint: Blueprint) -> dict[str, list[type[State]]]:
    """Return the state classes of each branch, in the blueprint's order: those that `source_of` defines.

    Args:
        blueprint: One that passed `pcmrs.fsm.rules.check_rules`.
    """
    module: dict[str, Any] = {"__name__": f"blueprint_{blueprint.id}"}
    # Executed, not built by type(): `pcmrs fsm generate` prints exactly the code that decides.
    exec(_compiled(source_of(blueprint), blueprint.id), module)  # noqa: S102  # names in it were checked
    states: dict[str, list[type[State]]] = module["STATES"]
    return states


def source_of(blueprint: Blueprint) -> str:
    """Return the Python source that a daemon of this blueprint executes.

    Args:
        blueprint: One that passed `pcmrs.fsm.rules.check_rules`.
    """
    return "\n".join([*_header(blueprint), *_classes(blueprint), *_index(blueprint), ""])


def _header(blueprint: Blueprint) -> Iterator[str]:
    yield _docstring(f"State Branches of {blueprint.title or blueprint.id}, generated from its blueprint.")
    yield ""
    yield f"# {blueprint.id} {blueprint.version}, blueprint {blueprint.hash}"
    yield ""
    outcomes = any(o.outcomes for branch in blueprint.branches.values() for o in branch.operations.values())
    yield f"from pcmrs.fsm.blueprint import OperationSpec{', OutcomeSpec' if outcomes else ''}"
    yield "from pcmrs.fsm._state import Answer, State"


def _classes(blueprint: Blueprint) -> Iterator[str]:
    for name, branch in blueprint.branches.items():
        yield from ("", "", f"class {class_name(name)}(State):")
        yield f"    {_docstring(branch.title or name)}"
        yield from (f"    # {line}" for line in _relations(branch))
        yield from ("", f"    branch = {_literal(name)}")
        for key, operation in branch.operations.items():
            yield ""
            yield from _constant(key, operation)
        for key in branch.operations:
            yield from ("", f"    def {key}(self) -> Answer:")
            yield f"        return self.refuse({_literal(key)})"
        for state in branch.states:
            yield from _state_class(name, branch, state)


def _relations(branch: BranchSpec) -> Iterator[str]:
    """Return comments on the other branches that this class depends on."""
    parent = branch.parent
    if parent is not None:
        yield f"Level {branch.level}, refines {parent.branch}; re-initiated when that enters {parent.start}: Rule 3."
        for state, called in branch.emits.items():
            yield f"A change to {state} calls {parent.branch}.{called} (Rule 2)."
            yield f"{state} fits {parent.branch} {', '.join(parent.compatible[state])}."
    for rule in branch.revocations:
        yield f"A change of {' or '.join(rule.by)} takes {' or '.join(rule.from_)} to {rule.to}."


def _constant(name: str, operation: OperationSpec) -> Iterator[str]:
    yield f"    {name.upper()} = OperationSpec("
    for key, value in _given(operation):
        line, raw = f"        {key}={value},", getattr(operation, key)
        if isinstance(raw, dict) and (key == "outcomes" or len(line) > LINE):
            yield f"        {key}={{"
            yield from (f"            {_literal(n)}: {_literal(o)}," for n, o in raw.items())
            yield "        },"
        else:
            yield line
    yield "    )"


def _state_class(name: str, branch: BranchSpec, state: str) -> Iterator[str]:
    base = class_name(name)
    yield from ("", "", f"class {_state_name(name, state)}({base}):")
    yield f"    {_docstring(branch.states[state])}"
    if activity := branch.activities.get(state):
        yield f"    # do / {_shown(activity)}"
    for timer in branch.timers_in(state).values():
        yield f"    # {_shown_timer(timer)}"
    yield from ("", f"    name = {_literal(state)}", f"    meaning = {_literal(branch.states[state])}")
    for key in branch.operations:
        if branch.valid_in(key, state):
            yield from ("", f"    def {key}(self) -> Answer:", f"        return self.{key.upper()}")


def _shown(activity: ActivitySpec) -> str:
    moves = ", which moves the robot" if activity.moves else ""
    return f"{activity.run}{moves}; when that ends by itself, {activity.ended}"


def _shown_timer(timer: TimerSpec) -> str:
    by = f"; restarted by {', '.join(timer.restarted_by)}" if timer.restarted_by else ""
    return f"{timer.when} / {timer.posts}{', repeated' if timer.repeat else ''}{by}"


def _index(blueprint: Blueprint) -> Iterator[str]:
    yield from ("", "", "STATES: dict[str, list[type[State]]] = {")
    for name, branch in blueprint.branches.items():
        yield f"    {_literal(name)}: ["
        yield from (f"        {_state_name(name, state)}," for state in branch.states)
        yield "    ],"
    yield "}"


@lru_cache(maxsize=16)
def _compiled(source: str, name: str) -> CodeType:
    """Return the compiled source, compiled once for all procedures of this process."""
    return compile(source, f"<blueprint {name}>", "exec")


def _state_name(branch: str, state: str) -> str:
    return f"{class_name(branch).removesuffix('Branch')}_{state}"


def _given(spec: msgspec.Struct) -> Iterator[tuple[str, str]]:
    """Fields that differ from their defaults and from what others imply, as Python."""
    implied = spec.implied if isinstance(spec, OperationSpec) else {}
    for field in _fields(type(spec)):
        value = getattr(spec, field.name)
        default = field.default_factory() if field.default_factory is not msgspec.NODEFAULT else field.default
        if value != implied.get(field.name, default):
            yield field.name, _literal(value)


@cache
def _fields(kind: type[msgspec.Struct]) -> tuple[msgspec.structs.FieldInfo, ...]:
    return msgspec.structs.fields(kind)


def _literal(value: Any) -> str:
    """Return plain data as Python. A JSON string is also a Python string, and no character in it can end it early."""
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)
    if isinstance(value, list):
        return f"[{', '.join(map(_literal, value))}]"
    if isinstance(value, dict):
        return "{" + ", ".join(f"{_literal(key)}: {_literal(item)}" for key, item in value.items()) + "}"
    if isinstance(value, msgspec.Struct):
        return f"{type(value).__name__}({', '.join(f'{key}={item}' for key, item in _given(value))})"
    return repr(value)


def _docstring(text: str) -> str:
    return f'""{_literal(text)}""'
