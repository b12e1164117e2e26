"""Names in a blueprint: valid on the bus, in Python and in the class of a branch, and unique."""

from __future__ import annotations

import keyword
import re
from collections.abc import Iterator

from pcmrs.fsm.blueprint import Blueprint, BranchSpec
from pcmrs.fsm.classes import RESERVED, class_name
from pcmrs.fsm.finding import Finding, Path

NAME = re.compile(r"[a-z][a-z0-9_]{0,63}")
STATE_NAME = re.compile(r"[a-z0-9][a-z0-9_]{0,31}")
VERSION = re.compile(r"[0-9A-Za-z][0-9A-Za-z.+-]{0,31}")
ENDINGS = frozenset({"started", "done", "failed", "unknown", "rejected"})
"""Endings that witnesses and tours report of any operation; an outcome cannot have these names."""


def check_names(blueprint: Blueprint) -> Iterator[Finding]:
    """Return names that cannot be used, or are used twice."""
    yield from _name(blueprint.id, "the workflow", ("id",))
    if not VERSION.fullmatch(blueprint.version):
        text = f"The version {blueprint.version!r} cannot be used: up to 32 letters, digits, dots, plus and minus."
        yield Finding(code="bad_name", text=text, path=("version",))
    if not blueprint.branches:
        yield Finding(code="no_branches", text="A workflow needs at least one branch.", path=("branches",))
    classes: dict[str, str] = {}
    flags: dict[str, str] = {}
    for name, branch in blueprint.branches.items():
        path = ("branches", name)
        yield from _name(name, "a branch", path)
        for operation, spec in branch.operations.items():
            where = (*path, "operations", operation)
            yield from _name(operation, f"an operation of {name}", where)
            for outcome in spec.outcomes:
                yield from _name(outcome, f"an outcome of {name}.{operation}", (*where, "outcomes", outcome), ENDINGS)
        for state, activity in branch.activities.items():
            yield from _name(activity.run, f"an activity of {name}", (*path, "activities", state, "run"))
        for timer in branch.timers:
            yield from _name(timer, f"a timer of {name}", (*path, "timers", timer))
        other = classes.setdefault(class_name(name), name)
        if other != name:
            text = f"The branches {other} and {name} would have the same class {class_name(name)}: rename one."
            yield Finding(code="name_collision", text=text, path=path)
        for flag in branch.flags:
            yield from _name(flag, f"a flag of {name}", (*path, "flags"))
            if flag in flags:
                text = f"The flag {flag} is declared twice, by {flags[flag]} and by {name}: one would hide the other."
                yield Finding(code="name_collision", text=text, path=(*path, "flags"))
            flags[flag] = name
        yield from _states(name, branch)
    for index, promise in enumerate(blueprint.properties):
        yield from _name(promise.id, "a property", ("properties", str(index), "id"))
    for index, stage in enumerate(blueprint.declared_stages):
        yield from _name(stage.id, "a stage", ("stage", str(index), "id"))


def _name(word: str, what: str, path: Path, reserved: frozenset[str] = RESERVED) -> Iterator[Finding]:
    if not NAME.fullmatch(word):
        text = f"{word[:70]!r} cannot be the name of {what}: a letter, then up to 63 of a-z, 0-9 and _."
        yield Finding(code="bad_name", text=text, path=path)
    elif keyword.iskeyword(word) or word in reserved:
        text = f"{word!r} cannot be the name of {what}: Python or PCMRS uses it. Choose another."
        yield Finding(code="reserved_name", text=text, path=path)


def _states(name: str, branch: BranchSpec) -> Iterator[Finding]:
    path = ("branches", name, "states")
    if not branch.states:
        yield Finding(code="no_states", text=f"{name} has no states: a branch needs at least one.", path=path[:2])
    for state in branch.states:
        if not STATE_NAME.fullmatch(state):
            text = f"{state[:40]!r} cannot be a state of {name}: a letter or digit, then up to 31 of a-z, 0-9 and _."
            yield Finding(code="bad_name", text=text, path=(*path, state))
        elif branch.flags and (len(state) != len(branch.flags) or set(state) - {"0", "1"}):
            text = (
                f"The state {state} of {name} must have one digit, 0 or 1, for each flag of {', '.join(branch.flags)}."
            )
            yield Finding(code="bad_flags", text=text, path=(*path, state))
