"""Properties of a blueprint: always, never, reachable, leads to; and that running operations can be concluded."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import msgspec
import numpy as np

from pcmrs.fsm.blueprint import Condition, PropertySpec
from pcmrs.fsm.finding import Finding
from pcmrs.fsm.verify._encoding import Batch, Mask
from pcmrs.fsm.verify._liveness import TimedOperations, stranded
from pcmrs.fsm.verify._moments import STOP, Moments
from pcmrs.fsm.verify._search import Visited

Wanted = Callable[[Batch], Mask]
"""Mask of the moments of a batch that match; shape (n,)."""

Specs = dict[int, PropertySpec]
"""Properties by their index in the file."""

PROPERTIES_PER_MOMENT = 50
"""Checking so many properties at a moment takes as long as finding it."""


def check_properties(runs: TimedOperations) -> Iterator[Finding]:
    """Return operations that cannot be concluded, and properties that do not hold or are vacuous.

    Properties that watch the same operations are checked together, those with the fewest operations first.
    """
    specs = dict(enumerate(runs.space.blueprint.properties))
    watching = {index: _observations(runs, spec) for index, spec in specs.items()}
    alone = {frozenset({name}): name for name in runs.strandable}
    found: dict[int, Finding] = {}
    for observed in sorted({*alone, *(each for sets in watching.values() for each in sets)}, key=_by_size):
        together = {i: specs[i] for i, sets in watching.items() if observed in sets and i not in found}
        if not together and observed not in alone:
            continue
        moments = runs.moments(observed)
        if observed in alone:
            yield from stranded(moments, alone[observed])
        runs.work.spend(len(moments.reached) * len(together) // PROPERTIES_PER_MOMENT)
        found |= _broken(moments, together, {i for i in together if watching[i][0] == observed})
    yield from (found[index] for index in sorted(found))


def _by_size(observed: frozenset[str]) -> tuple[int, list[str]]:
    return len(observed), sorted(observed)


def _observations(runs: TimedOperations, spec: PropertySpec) -> list[frozenset[str]]:
    """Return the sets of operations to watch, one after the other.

    The first has those that the property names. A property of Stop also watches, one by one, each operation that might
    not be concludable.
    """
    conditions = [spec.when, *filter(None, (spec.always, spec.never, spec.reachable, spec.leads_to))]
    mentioned = frozenset(name for condition in conditions for name in condition.running)
    if spec.reachable is None and any(STOP in condition.accepted for condition in conditions):
        return [mentioned, *(mentioned | {name} for name in runs.strandable if name not in mentioned)]
    return [mentioned]


def _broken(moments: Moments, specs: Specs, new: set[int]) -> dict[int, Finding]:
    """Return the properties that do not hold at these moments and, of the new ones, those that are vacuous."""
    occurring = {i: _both(moments, specs[i].when, specs[i].reachable or Condition()) for i in new}
    occurs = moments.reached.firsts(occurring)
    found = {i: _vacuous(i, specs[i]) for i in new - occurs.keys()}
    for part in _by_goal({i: spec for i, spec in specs.items() if i not in found and spec.reachable is None}):
        goal = next(iter(part.values())).leads_to
        open_ = None if goal is None else moments.states_leading_to(goal)
        against = {
            i: _against(moments, spec) if open_ is None else _closed(moments, spec, open_) for i, spec in part.items()
        }
        for i, code in moments.reached.firsts(against).items():
            found[i] = _violated(i, specs[i], moments, code)
    return found


def _by_goal(specs: Specs) -> list[Specs]:
    """Return groups of properties with the same `leads_to`: one backward search serves them all."""
    groups: dict[bytes, Specs] = {}
    for index, spec in specs.items():
        groups.setdefault(msgspec.json.encode(spec.leads_to), {})[index] = spec
    return list(groups.values())


def _against(moments: Moments, spec: PropertySpec) -> Wanted:
    """Return the mask of moments that contradict a property of single moments."""
    if spec.never is not None:
        return _both(moments, spec.when, spec.never)
    always = spec.always or Condition()
    return lambda batch: moments.hold(spec.when, batch) & ~moments.hold(always, batch)


def _closed(moments: Moments, spec: PropertySpec, open_: Visited) -> Wanted:
    """Return the mask of moments that contradict a `leads_to`; from those in `open_` it can be reached."""
    return lambda batch: moments.hold(spec.when, batch) & ~open_.has(batch.codes)


def _both(moments: Moments, *conditions: Condition) -> Wanted:
    return lambda batch: np.logical_and.reduce([moments.hold(condition, batch) for condition in conditions])


def _violated(index: int, spec: PropertySpec, moments: Moments, code: int) -> Finding:
    what = "from there its `leads_to` cannot be reached" if spec.leads_to is not None else "there it is broken"
    text = f"{spec.id} does not hold: {moments.describe_state(code)}: {what}."
    return _finding("property_violated", index, spec, text, moments.path_to(code))


def _vacuous(index: int, spec: PropertySpec) -> Finding:
    if spec.reachable is not None:
        return _finding("property_violated", index, spec, f"{spec.id} does not hold: its condition is never met.")
    text = f"{spec.id} promises nothing: its `when` holds at no reachable moment."
    return _finding("vacuous_property", index, spec, text)


def _finding(code: str, index: int, spec: PropertySpec, text: str, commands: tuple[str, ...] | None = None) -> Finding:
    full = text + (f" It promises: {spec.text}" if spec.text else "")
    return Finding(code=code, text=full, path=("properties", str(index)), commands=commands)
