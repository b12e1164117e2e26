"""Reads blueprint files: returns the workflow, or all that is wrong with the file."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path as FilePath
from typing import Any

import msgspec

from pcmrs.errors import BlueprintError
from pcmrs.fsm.blueprint import Blueprint, BranchSpec, OperationSpec
from pcmrs.fsm.files._confirming import expand_confirmations
from pcmrs.fsm.files.extend import read_layers
from pcmrs.fsm.files.places import Places, with_locations
from pcmrs.fsm.files.sequence import SequenceError, expand
from pcmrs.fsm.files.toml import convert, read_bounded
from pcmrs.fsm.finding import Finding, summary
from pcmrs.fsm.rules import check_rules
from pcmrs.fsm.rules.declared import KnownHazards, check_declared
from pcmrs.fsm.verify import MAX_JOINT_STATES, verify


@dataclass(frozen=True, slots=True)
class BlueprintExamination:
    """Result of reading and verifying a blueprint file.

    Attributes:
        blueprint: The workflow as far as it could be read; None where it could not.
        findings: All that is wrong; empty for a sound workflow.
        joint_states: Number of joint states that can be reached; 0 if the search did not end.
        transitions: Commands accepted in them, with each of their endings.
        warnings: Old forms that are still accepted and should be rewritten.
    """

    blueprint: Blueprint | None
    findings: list[Finding] = field(default_factory=list)
    joint_states: int = 0
    transitions: int = 0
    warnings: list[Finding] = field(default_factory=list)

    @property
    def readable(self) -> bool:
        """The file is a blueprint, sound or not."""
        return self.blueprint is not None

    @property
    def sound(self) -> bool:
        """A daemon would run it."""
        return self.readable and not self.findings


def load_blueprint(path: FilePath, *, warn: Callable[[Finding], object] | None = None) -> Blueprint:
    """Read the blueprint at `path`.

    Args:
        path: Blueprint file.
        warn: Called with each warning.

    Raises:
        BlueprintError: The file cannot be read, or is not a sound blueprint.
    """
    try:
        raw = read_bounded(path)
    except OSError as error:
        raise BlueprintError(f"{path}: cannot be read: {error.strerror}", path=str(path)) from error
    return parse_blueprint(raw, origin=str(path), folder=path.parent, warn=warn)


def parse_blueprint(
    raw: bytes,
    *,
    origin: str = "blueprint",
    folder: FilePath | None = None,
    warn: Callable[[Finding], object] | None = None,
) -> Blueprint:
    """Return the sound workflow in a file.

    Args:
        raw: The file.
        origin: Name of the file in findings.
        folder: Folder of the file; without one it can extend no other file.
        warn: Called with each warning.

    Raises:
        BlueprintError: It cannot be read or is unsound; `findings` has all faults.
    """
    examination = examine(raw, origin=origin, folder=folder)
    if warn is not None:
        for warning in examination.warnings:
            warn(warning)
    if examination.blueprint is None or examination.findings:
        raise BlueprintError(summary(examination.findings), findings=examination.findings)
    return examination.blueprint


def examine(
    raw: bytes,
    *,
    origin: str = "blueprint",
    folder: FilePath | None = None,
    limit: int = MAX_JOINT_STATES,
    progress: Callable[[int, int], None] | None = None,
    known: KnownHazards | None = None,
) -> BlueprintExamination:
    """Read a blueprint, check its rules, and search all its joint states.

    Args:
        raw: The file.
        origin: Name of the file in findings.
        folder: Folder of the file; without one it can extend no other file.
        limit: Largest number of joint states; a workflow of more is refused.
        progress: See `pcmrs.fsm.verify.verify`.
        known: Registered steps and activities that are known to move the robot or affect the patient.
    """
    try:
        blueprint, places, warnings = _read(raw, origin, folder)
    except BlueprintError as error:
        return BlueprintExamination(None, error.fields["findings"])
    broken = list(check_rules(blueprint)) or list(check_declared(blueprint, known or KnownHazards()))
    if broken:
        return BlueprintExamination(blueprint, with_locations(broken, places), warnings=warnings)
    found = verify(blueprint, limit=limit, progress=progress)
    findings = with_locations(found.findings, places)
    return BlueprintExamination(blueprint, findings, found.joint_states, found.transitions, warnings)


def read_blueprint(raw: bytes, origin: str, folder: FilePath | None = None) -> tuple[Blueprint | None, list[Finding]]:
    """Return the workflow in a file, sound or not, or the findings why it cannot be read.

    Args:
        raw: The file.
        origin: Name of the file in findings.
        folder: Folder of the file; without one it can extend no other file.
    """
    try:
        return _read(raw, origin, folder)[0], []
    except BlueprintError as error:
        return None, error.fields["findings"]


def load_unexpanded(path: FilePath) -> Blueprint:
    """Return the blueprint at `path` as its file and the file that it extends say: nothing is expanded or verified.

    Raises:
        OSError: It cannot be opened.
        BlueprintError: It is not a blueprint; `findings` has where.
    """
    table, places, _ = read_layers(read_bounded(path), str(path), path.parent)
    return convert(table, Blueprint, places)


def _read(raw: bytes, origin: str, folder: FilePath | None) -> tuple[Blueprint, Places, list[Finding]]:
    table, places, warnings = read_layers(raw, origin, folder)
    blueprint = convert(table, Blueprint, places)
    # The hash identifies the content when a journal is continued: a file must not claim one.
    if "hash" in table:
        finding = Finding(code="bad_value", text="`hash` is computed from the content: leave it out.", path=("hash",))
        raise BlueprintError(finding.text, findings=with_locations([finding], places))
    try:
        blueprint = expand(blueprint)
    except SequenceError as error:
        finding = Finding(code="bad_sequence", text=error.text, path=error.path)
        raise BlueprintError(error.text, findings=with_locations([finding], places)) from None
    blueprint = expand_confirmations(blueprint)
    return msgspec.structs.replace(blueprint, hash=content_hash(blueprint)), places, warnings


def content_hash(blueprint: Blueprint) -> str:
    """Return the SHA-256 of the content of a blueprint, hexadecimal.

    Comments, layout, its migrations and its stages do not matter. Of orders, only that of the states does.
    """
    # The order of states has a meaning (the first is the start), but the deterministic encoder sorts all keys.
    order = sorted((name, list(branch.states)) for name, branch in blueprint.branches.items())
    branches = {name: _hashed_branch(branch) for name, branch in blueprint.branches.items()}
    bare = msgspec.structs.replace(blueprint, hash="", migrations=[], stage=msgspec.UNSET, branches=branches)
    content = msgspec.json.encode([order, bare], order="deterministic")
    return hashlib.sha256(content).hexdigest()


OPERATION_FIELDS = msgspec.structs.fields(OperationSpec)
BRANCH_FIELDS = msgspec.structs.fields(BranchSpec)

FIRST_NAMES = {"affects_patient": "acts"}
"""Keys that were renamed: journals name the hash, which must not change when a key is only renamed."""


def _hashed_branch(branch: BranchSpec) -> Any:
    """Return a branch with its operations as they are hashed, without `timers`, a later key, if it has none."""
    operations = {key: _hashed(each) for key, each in branch.operations.items()}
    hashed = msgspec.structs.replace(branch, operations=operations)
    named = {each.encode_name: getattr(hashed, each.name) for each in BRANCH_FIELDS if each.name != "timers"}
    named |= {"timers": branch.timers} if branch.timers else {}
    encoded = {key: msgspec.Raw(msgspec.json.encode(value, order="deterministic")) for key, value in named.items()}
    return msgspec.Raw(msgspec.json.encode(encoded))


def _hashed(operation: OperationSpec) -> msgspec.Raw:
    """Return an operation under the first names of its keys, without later keys that have their implied values."""
    encoded: dict[str, msgspec.Raw] = {}
    implied = operation.implied
    for each in OPERATION_FIELDS:
        value = getattr(operation, each.name)
        if each.name not in implied or value != implied[each.name]:
            name = FIRST_NAMES.get(each.encode_name, each.encode_name)
            encoded[name] = msgspec.Raw(msgspec.json.encode(value, order="deterministic"))
    return msgspec.Raw(msgspec.json.encode(encoded))
