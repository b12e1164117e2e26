"""The promises of a blueprint: always, never, reachable, leads to."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from pcmrs.fsm.blueprint import Condition, PropertySpec
from pcmrs.fsm.finding import Finding
from pcmrs.fsm.verify.encoding import Batch
from pcmrs.fsm.verify.moments import STOP, Moments
from pcmrs.fsm.verify.running import Runs
from pcmrs.fsm.verify.search import leading_to


def properties(runs: Runs) -> Iterator[Finding]:
    """Every property that does not hold, with a shortest sequence of commands where one shows it."""
    for index, spec in enumerate(runs.space.blueprint.properties):
        found = next(filter(None, (_violation(spec, runs.moments(each)) for each in _observations(runs, spec))), None)
        if found is not None:
            text, commands = found
            said = f"{spec.id} does not hold: {text}" + (f" It promises: {spec.text}" if spec.text else "")
            yield Finding(code="property_violated", text=said, path=("properties", str(index)), commands=commands)


def _observations(runs: Runs, spec: PropertySpec) -> Iterator[frozenset[str]]:
    """Sets of operations to watch, one after the other.

    Those that the property speaks of; for Stop, together with each of which it is not plain that it can be concluded.
    """
    conditions = [spec.when, *filter(None, (spec.always, spec.never, spec.reachable, spec.leads_to))]
    mentioned = frozenset(name for condition in conditions for name in condition.running)
    yield mentioned
    if any(STOP in condition.accepted for condition in conditions):
        yield from (mentioned | {name} for name in runs.strandable)


def _violation(spec: PropertySpec, moments: Moments) -> tuple[str, tuple[str, ...] | None] | None:
    """What is wrong and how to get there, if the property does not hold."""
    if spec.reachable is not None:
        wanted = _both(moments, spec.when, spec.reachable)
        return None if moments.reached.first(wanted) is not None else ("nothing leads to what it names.", None)
    code = moments.reached.first(_against(spec, moments))
    if code is None:
        return None
    what = "nothing leads from there to what it names" if spec.leads_to is not None else "there it is broken"
    return f"{moments.shown(code)}: {what}.", moments.way_to(code)


def _against(spec: PropertySpec, moments: Moments) -> Callable[[Batch], NDArray[np.bool_]]:
    """Which moments contradict the property."""
    if spec.never is not None:
        return _both(moments, spec.when, spec.never)
    if spec.leads_to is not None:
        goal = moments.reached.which(_both(moments, spec.leads_to))
        open_ = leading_to(moments.reached, goal, moments.transitions)
        return lambda batch: moments.hold(spec.when, batch) & ~open_.has(batch.codes)
    always = spec.always or Condition()
    return lambda batch: moments.hold(spec.when, batch) & ~moments.hold(always, batch)


def _both(moments: Moments, *conditions: Condition) -> Callable[[Batch], NDArray[np.bool_]]:
    return lambda batch: np.logical_and.reduce([moments.hold(condition, batch) for condition in conditions])
