"""Workflows with a part declared otherwise; rules are not looked at."""

from __future__ import annotations

from typing import Any

import msgspec

from pcmrs.fsm import Blueprint


def with_branch(blueprint: Blueprint, name: str, **fields: Any) -> Blueprint:
    changed = msgspec.structs.replace(blueprint.branches[name], **fields)
    return msgspec.structs.replace(blueprint, branches={**blueprint.branches, name: changed})


def with_operation(blueprint: Blueprint, branch: str, operation: str, **fields: Any) -> Blueprint:
    operations = blueprint.branches[branch].operations
    changed = msgspec.structs.replace(operations[operation], **fields)
    return with_branch(blueprint, branch, operations={**operations, operation: changed})
