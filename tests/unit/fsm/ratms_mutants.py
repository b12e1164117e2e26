"""RATMS with one thing taken out or changed."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping
from functools import cache, partial
from itertools import permutations
from pathlib import Path
from types import MappingProxyType
from typing import Any

import msgspec

import pcmrs.workflows
from pcmrs.fsm.blueprint import Blueprint
from tests.support.shipped import shipped_blueprint

FILE = Path(pcmrs.workflows.__file__).parent / "ratms.toml"


def changed(change: Callable[[dict[str, Any]], object]) -> Blueprint:
    """The workflow after a change of its branches as plain dictionaries."""
    table = copy.deepcopy(msgspec.to_builtins(shipped_blueprint("ratms")))
    change(table["branches"])
    return msgspec.convert(table, Blueprint)


def without(branch: str, operation: str, key: str) -> Blueprint:
    """The workflow with one key of an operation left out."""
    return changed(lambda branches: branches[branch]["operations"][operation].pop(key))


@cache
def mutants() -> Mapping[str, Callable[[], Blueprint]]:
    """The workflow without each requirement, set state, signal, event and revocation, one at a time: name to maker."""
    found: dict[str, Callable[[], Blueprint]] = {}
    for name, branch in shipped_blueprint("ratms").branches.items():
        for operation, spec in branch.operations.items():
            for key in ("requires", "sets", "signals", "event"):
                if getattr(spec, key):
                    found[f"{name}.{operation} without {key}"] = partial(without, name, operation, key)
    found["no revocation"] = partial(changed, lambda branches: branches["placement"].update(revocations=[]))
    for by, other in permutations(("registration", "toolplan")):
        found[f"no revocation by {by}"] = partial(revoked, by=[other])
    at_body = ("standoff", "placed", "following", "guided", "replanned")
    for state in at_body:
        found[f"{state} not revoked"] = partial(revoked, **{"from": [each for each in at_body if each != state]})
    return MappingProxyType(found)


def revoked(**keys: list[str]) -> Blueprint:
    """The workflow with other keys of its one revocation."""
    return changed(lambda branches: branches["placement"]["revocations"][0].update(keys))
