"""Expands `confirm = true` into a branch in which a user confirms an operation each time before it is accepted.

A confirmation is consumed by the next command of the operation's branch, whatever that is, and by any command of a
branch that can release the latch of Stop: a confirmation before a Stop does not count after it.
"""

from __future__ import annotations

from collections.abc import Iterator

import msgspec

from pcmrs.fsm.blueprint import Blueprint, BranchSpec, OperationSpec, RevocationSpec

OPEN, GIVEN = "open", "given"
REFUSAL = "not_confirmed"
"""Code of the rejection of an operation that has not been confirmed."""


def _confirmation_of(blueprint: Blueprint, branch: str, operation: str) -> str:
    """Return the name of the branch in which an operation is confirmed.

    Args:
        blueprint: The workflow.
        branch: Branch of the operation.
        operation: Name of the operation. The branch is named after it alone, unless another branch has one of this
            name.
    """
    shared = any(operation in spec.operations for name, spec in blueprint.branches.items() if name != branch)
    return f"{branch}_{operation}_confirmation" if shared else f"{operation}_confirmation"


def expand_confirmations(blueprint: Blueprint) -> Blueprint:
    """Return the workflow with each `confirm` replaced by the branch that it stands for.

    An operation that cannot be confirmed keeps its `confirm`: see `pcmrs.fsm.rules._shapes`.

    Args:
        blueprint: Workflow with expanded sequences.
    """
    branches = dict(blueprint.branches)
    for name, key, operation in _confirmed(blueprint):
        made = _confirmation_of(blueprint, name, key)
        if made in branches or operation.iio or operation.event or operation.rio:
            continue  # `confirm` stays true, which the rules then refuse
        operations = branches[name].operations | {key: _requiring(operation, made)}
        branches[name] = msgspec.structs.replace(branches[name], operations=operations)
        by = [name, *(release.partition(".")[0] for release in blueprint.unlatching)]
        branches[made] = _branch(name, key, operation, list(dict.fromkeys(by)))
    return msgspec.structs.replace(blueprint, branches=branches)


def _confirmed(blueprint: Blueprint) -> Iterator[tuple[str, str, OperationSpec]]:
    for name, branch in blueprint.branches.items():
        yield from ((name, key, operation) for key, operation in branch.operations.items() if operation.confirm)


def _requiring(operation: OperationSpec, made: str) -> OperationSpec:
    refusal = operation.refusal
    refusals = dict.fromkeys(operation.requires, refusal) if isinstance(refusal, str) else refusal
    requires = operation.requires | {made: [GIVEN]}
    return msgspec.structs.replace(operation, confirm=False, requires=requires, refusal=refusals | {made: REFUSAL})


def _branch(name: str, key: str, operation: OperationSpec, by: list[str]) -> BranchSpec:
    title = operation.title or key.replace("_", " ")
    possible = {} if operation.from_ == ["*"] else {name: operation.from_}
    confirm = OperationSpec(
        title=f"Confirm: {title}",
        from_=[OPEN],
        to=GIVEN,
        requires=possible,
        roles=operation.roles,
        blocked_when_latched=True,
    )
    take_back = OperationSpec(title=f"Take the confirmation back: {title}", from_=[GIVEN], to=OPEN, rio=True)
    return BranchSpec(
        title=f"Confirmation: {title}",
        states={OPEN: "not confirmed", GIVEN: "confirmed: may be done once"},
        operations={f"confirm_{key}": confirm, "take_back": take_back},
        revocations=[RevocationSpec(by=by, from_=[GIVEN], to=OPEN)],
    )
