"""The joint states of a workflow as a Promela model, to be searched by SPIN: a second opinion on `verify`."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import islice

import msgspec

from pcmrs.authoring.exchange._cubes import Cube, merge
from pcmrs.errors import BlueprintError
from pcmrs.fsm.behaviour import operations
from pcmrs.fsm.blueprint import START_OUTCOME, Blueprint, Condition, PropertySpec, Requirement
from pcmrs.fsm.verify.decision import Decider, DecisionCase
from pcmrs.visible import visible

__all__ = ["promela"]

MAX_DECISIONS = 5_000
"""Limit of combinations that the operations depend on; a larger model could neither be read nor compiled."""

STOP = "stop"


@dataclass(frozen=True, slots=True)
class _Way:
    """One ending of a command: where it is accepted, and what it changes."""

    command: str
    guard: str
    targets: Mapping[str, str]
    by_user: bool  # by a user, not by the environment: a device or a timer
    origin: str = ""  # the timers that post it


def promela(blueprint: Blueprint) -> str:
    """Return a model with one guarded, indivisible transition for each ending of each operation.

    It has the claims ``deadlock`` (at every moment a user may ask for something, or the goal is reached),
    ``children_fit``, and ``property_<n>`` for every property that speaks of states only and is always, never or
    reachable; a reachable one is claimed never to hold, so that SPIN shows the path there. Time is not part of the
    model: the environment may choose the event of a timer at any moment.

    Args:
        blueprint: A sound or unsound workflow that obeys the static rules.

    Raises:
        BlueprintError: The operations depend on more than `MAX_DECISIONS` combinations of states.
    """
    ways = list(_ways(blueprint))
    lines = [*_head(blueprint), "", *_variables(blueprint), "", *_process(ways), "", *_claims(blueprint, ways)]
    return "\n".join(lines) + "\n"


def _head(blueprint: Blueprint) -> list[str]:
    return [
        f"/* Workflow {blueprint.id} {blueprint.version}: its joint states, for SPIN.",
        *_origin(blueprint),
        "   spin -a FILE && cc -o pan pan.c && ./pan -noclaim -E    counts them;",
        "   ./pan -E -N CLAIM                                       checks one of the claims below. */",
    ]


def _origin(blueprint: Blueprint) -> list[str]:
    """Return a line of the comment: how a language model has drafted the workflow."""
    given = blueprint.provenance
    if given is msgspec.UNSET:
        return []
    text = f"Drafted by {given.model} on {given.date}, prompt {given.prompt}, protocol {given.protocol}."
    return [f"   {visible(text).replace('*/', '* /')}"]


def _variables(blueprint: Blueprint) -> Iterator[str]:
    for name, branch in blueprint.branches.items():
        yield from (f"#define {_constant(name, state)} {number}" for number, state in enumerate(branch.states))
        kind = "byte" if len(branch.states) <= 256 else "short"
        yield f"{kind} {_variable(name)} = {_constant(name, branch.start)};"


def _process(ways: list[_Way]) -> Iterator[str]:
    yield "active proctype workflow() {"
    yield "do"
    for way in ways:
        moves = [f"{_variable(name)} = {_constant(name, state)}" for name, state in way.targets.items()]
        yield f":: d_step {{ {way.guard} -> {'; '.join(moves) or 'skip'} }} /* {way.command}{way.origin} */"
    yield ":: false -> skip"
    yield "od"
    yield "}"


def _claims(blueprint: Blueprint, ways: list[_Way]) -> Iterator[str]:
    goal = [_states(blueprint.goal)] if blueprint.goal else []
    yield from _claim("deadlock", [*dict.fromkeys(way.guard for way in ways if way.by_user), *goal])
    yield from _claim("children_fit", [_children_fit(blueprint)])
    for index, spec in enumerate(blueprint.properties):
        holds = _holds(spec, ways)
        comment = f"/* property {index}, {_harmless(spec.id)}"
        yield f"{comment} */" if holds else f"{comment}: it needs `running` or `leads_to`, which are not modelled */"
        if holds:
            yield from _claim(f"property_{index}", holds)


def _claim(name: str, holds: Iterable[str]) -> Iterator[str]:
    """Return a claim that at every moment one of some conditions holds."""
    yield f"never {name} {{"
    yield "do"
    yield from (f":: {condition}" for condition in holds)
    yield ":: atomic { else -> assert(false) }"
    yield "od"
    yield "}"


def _holds(spec: PropertySpec, ways: list[_Way]) -> list[str]:
    """Return conditions of which one must hold at every moment; none if the model cannot express it."""
    conditions = [spec.when, *filter(None, (spec.always, spec.never, spec.reachable))]
    if spec.leads_to is not None or any(each.running or STOP in each.accepted for each in conditions):
        return []
    when, other = (_condition(each, ways) for each in conditions)
    return [f"!({when})", other if spec.always is not None else f"!({other})"]


def _condition(condition: Condition, ways: list[_Way]) -> str:
    accepted = (_any(w.guard for w in ways if w.command.partition(":")[0] == name) for name in condition.accepted)
    return _all([_states(condition.states), *accepted])


def _children_fit(blueprint: Blueprint) -> str:
    return _all(
        _any(
            _states({name: [state], branch.parent.branch: fitting})
            for state, fitting in branch.parent.compatible.items()
        )
        for name, branch in blueprint.branches.items()
        if branch.parent is not None
    )


def _ways(blueprint: Blueprint) -> Iterator[_Way]:
    """Return every ending of every operation, with as few and short guards as possible."""
    states = {name: list(branch.states) for name, branch in blueprint.branches.items()}
    left = MAX_DECISIONS
    for branch, operation, spec in operations(blueprint):
        found: dict[tuple[str, frozenset[tuple[str, str]]], list[Cube]] = {}
        decisions = [] if spec.iio else list(islice(_decisions(blueprint, branch, operation), left + 1))
        left -= len(decisions)
        if left < 0:
            text = f"The operations depend on over {MAX_DECISIONS} combinations of states: too many for a model."
            raise BlueprintError(text, limit=MAX_DECISIONS)
        for decision in decisions:
            cube = {name: frozenset({state}) for name, state in decision.seen.items()}
            for name, states_after in decision.endings.items():
                command = f"{branch}.{operation}" + (f":{name}" if name != START_OUTCOME else "")
                found.setdefault((command, frozenset(states_after.items())), []).append(cube)
        origin = _timers(blueprint, branch, operation)
        for (command, targets), cubes in found.items():
            for cube in merge(cubes, states):
                guard = _states({name: sorted(allowed) for name, allowed in cube.items()})
                yield _Way(command, guard, dict(sorted(targets)), by_user=not spec.event, origin=origin)


def _timers(blueprint: Blueprint, branch: str, operation: str) -> str:
    """Return the timers that post an operation: the environment may choose it at any moment, so also at theirs."""
    timers = blueprint.branches[branch].timers.items()
    posting = [f"timer {name} {timer.when}" for name, timer in timers if timer.posts == operation]
    return f", environment: {', '.join(posting)}" if posting else ""


def _decisions(blueprint: Blueprint, branch: str, operation: str) -> Iterator[DecisionCase]:
    """Return every decision of an operation in whatever states; no search has to have found them."""
    decider, initial = Decider(blueprint), blueprint.initial()
    waiting: list[dict[str, str]] = [{}]
    while waiting:
        fixed = waiting.pop()
        decision = decider.decide({**initial, **fixed}, branch, operation)
        yield decision
        before: dict[str, str] = {}
        for name, state in decision.seen.items():
            if name not in fixed:
                others = (other for other in blueprint.branches[name].states if other != state)
                waiting += [{**before, name: other} for other in others]
            before[name] = state


def _states(states: Requirement) -> str:
    return _all(
        _any(f"{_variable(name)} == {_constant(name, each)}" for each in named) for name, named in states.items()
    )


def _all(terms: Iterable[str]) -> str:
    return _joined(terms, "&&", "true")


def _any(terms: Iterable[str]) -> str:
    return _joined(terms, "||", "false")


def _joined(terms: Iterable[str], sign: str, empty: str) -> str:
    found = [term for term in terms if term != empty]
    return f"({f' {sign} '.join(found)})" if len(found) > 1 else (found or [empty])[0]


def _variable(branch: str) -> str:
    """Return the variable of a branch, never a keyword of Promela: names in a blueprint have no capitals."""
    return f"AT_{branch}"


def _constant(branch: str, state: str) -> str:
    return f"{branch}_IS_{state}"


def _harmless(text: str) -> str:
    """Return text that cannot end a comment."""
    return "".join(sign if sign.isalnum() or sign in " _-." else "_" for sign in text)
