"""Reads blueprint files: what is wrong with one, or the workflow in it."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path as FilePath

import msgspec

from pcmrs.errors import BlueprintError
from pcmrs.fsm.blueprint import Blueprint
from pcmrs.fsm.files.bounded import read_bounded
from pcmrs.fsm.files.places import Places, placed
from pcmrs.fsm.files.sequence import SequenceError, expand
from pcmrs.fsm.files.toml import convert, read_toml
from pcmrs.fsm.finding import Finding, summary
from pcmrs.fsm.rules import check_rules
from pcmrs.fsm.verify import MAX_JOINT_STATES, verify


@dataclass(frozen=True, slots=True)
class Examination:
    """What there is to say of a blueprint file.

    Attributes:
        blueprint: The workflow as far as it could be read; None where it could not.
        findings: All that is wrong; empty for a sound workflow.
        joint_states: How many of them can be reached, where the search came to its end.
        transitions: Commands accepted in them, with each of their endings.
    """

    blueprint: Blueprint | None
    findings: list[Finding] = field(default_factory=list)
    joint_states: int = 0
    transitions: int = 0

    @property
    def readable(self) -> bool:
        """Whether the file is a blueprint, sound or not."""
        return self.blueprint is not None

    @property
    def sound(self) -> bool:
        """Whether a daemon would run it."""
        return self.readable and not self.findings


def load_blueprint(path: FilePath) -> Blueprint:
    """Reads the blueprint at `path`; see `parse_blueprint`.

    Raises:
        BlueprintError: The file cannot be read, or is no sound blueprint.
    """
    try:
        raw = read_bounded(path)
    except OSError as error:
        raise BlueprintError(f"{path}: cannot be read: {error.strerror}", path=str(path)) from error
    return parse_blueprint(raw, origin=str(path))


def parse_blueprint(raw: bytes, *, origin: str = "blueprint") -> Blueprint:
    """The sound workflow in a file.

    Args:
        raw: The file.
        origin: How findings call it.

    Raises:
        BlueprintError: It cannot be read or is unsound; `findings` has all that is wrong.
    """
    examination = examine(raw, origin=origin)
    if examination.blueprint is None or examination.findings:
        raise BlueprintError(summary(examination.findings), findings=examination.findings)
    return examination.blueprint


def examine(
    raw: bytes,
    *,
    origin: str = "blueprint",
    limit: int = MAX_JOINT_STATES,
    progress: Callable[[int, int], None] | None = None,
) -> Examination:
    """Reads a blueprint, checks its rules, and searches all its joint states.

    Args:
        raw: The file.
        origin: How findings call it.
        limit: A workflow of more joint states is refused.
        progress: See `pcmrs.fsm.verify.verify`.
    """
    try:
        blueprint, places = _read(raw, origin)
    except BlueprintError as error:
        return Examination(None, error.fields["findings"])
    broken = list(check_rules(blueprint))
    if broken:
        return Examination(blueprint, placed(broken, places, origin))
    found = verify(blueprint, limit=limit, progress=progress)
    return Examination(blueprint, placed(found.findings, places, origin), found.joint_states, found.transitions)


def read_blueprint(raw: bytes, origin: str) -> tuple[Blueprint | None, list[Finding]]:
    """The workflow in a file, sound or not, or why it cannot be read."""
    try:
        return _read(raw, origin)[0], []
    except BlueprintError as error:
        return None, error.fields["findings"]


def _read(raw: bytes, origin: str) -> tuple[Blueprint, Places]:
    table, places = read_toml(raw, origin)
    blueprint = convert(table, Blueprint, places, origin)
    if "hash" in table:
        finding = Finding(code="bad_value", text="`hash` is worked out from the content: leave it out.", path=("hash",))
        raise BlueprintError(finding.text, findings=placed([finding], places, origin))
    try:
        blueprint = expand(blueprint)
    except SequenceError as error:
        finding = Finding(code="bad_sequence", text=error.text, path=error.path)
        raise BlueprintError(error.text, findings=placed([finding], places, origin)) from None
    return msgspec.structs.replace(blueprint, hash=content_hash(blueprint)), places


def content_hash(blueprint: Blueprint) -> str:
    """SHA-256 of what a blueprint says, hexadecimal.

    Comments, layout and its migrations do not matter, nor does the order of what has none: only states have one.
    """
    order = sorted((name, list(branch.states)) for name, branch in blueprint.branches.items())
    bare = msgspec.structs.replace(blueprint, hash="", migrations=[])
    content = msgspec.json.encode([order, bare], order="deterministic")
    return hashlib.sha256(content).hexdigest()
