"""A workflow loads only with functions that fit its blueprint."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from pcmrs.dispatcher import Registry, Workflow
from pcmrs.errors import BlueprintError
from tests.unit.dispatcher.dispatcher_fakes import RATMS, Bench, Notes, make_workflow
from tests.unit.dispatcher.following import FOLLOWING


def test_a_name_that_is_not_registered_is_refused() -> None:
    registry: Registry[Any, Notes] = Registry()
    specs = [spec for branch in FOLLOWING.branches.values() for spec in branch.operations.values()]
    registry.checks |= {name: lambda run: None for spec in specs for name in spec.checks}
    registry.steps |= {name: lambda run: None for spec in specs for name in spec.steps}
    with pytest.raises(BlueprintError, match="placement following: no activity is registered as 'follow_head'"):
        Workflow(FOLLOWING, registry, Notes(), lambda data, states, effects: data)
    with pytest.raises(BlueprintError, match="async def"):
        registry.activity(lambda act: None)


@pytest.mark.parametrize("kind", ["step", "activity"])
def test_step_must_be_plain_and_activity_a_coroutine(kind: str) -> None:
    async def waiting(_run: object) -> None: ...

    def at_once(_run: object) -> None: ...

    registry: Registry[Any, Any] = Registry()
    register: Callable[[Any], object] = getattr(registry, kind)
    with pytest.raises(BlueprintError):
        register(waiting if kind == "step" else at_once)


async def test_an_unregistered_name_stops_the_workflow_from_loading(bench: Bench) -> None:
    workflow = make_workflow(bench.script)
    del workflow.registry.checks[RATMS.branches["registration"].operations["register"].checks[0]]
    with pytest.raises(BlueprintError, match=r"registration\.register: no check is registered"):
        type(workflow)(RATMS, workflow.registry, Notes(), workflow.settle)
