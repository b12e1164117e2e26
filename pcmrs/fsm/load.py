"""Reads a blueprint file and refuses an unsound one."""

from __future__ import annotations

import hashlib
import tomllib
from pathlib import Path

import msgspec

from pcmrs.errors import BlueprintError
from pcmrs.fsm.blueprint import Blueprint
from pcmrs.fsm.rules import check_rules


def load_blueprint(path: Path) -> Blueprint:
    """Reads and checks the blueprint at `path`.

    Raises:
        BlueprintError: The file cannot be read, holds an unknown key or wrong type, or breaks a rule;
            the text names the file, the rule, the branch and the state.
    """
    try:
        raw = path.read_bytes()
    except OSError as error:
        raise BlueprintError(f"{path}: cannot be read: {error.strerror}", path=str(path)) from error
    return parse_blueprint(raw, origin=str(path))


def parse_blueprint(raw: bytes, *, origin: str = "blueprint") -> Blueprint:
    """Parses and checks a blueprint; `origin` is how errors call it. Raises `BlueprintError`."""
    try:
        table = tomllib.loads(raw.decode())
        blueprint = msgspec.convert(table, Blueprint)
    except UnicodeDecodeError as error:
        raise BlueprintError(f"{origin}: not UTF-8 at byte {error.start}", path=origin) from error
    except tomllib.TOMLDecodeError as error:
        raise BlueprintError(f"{origin}: not TOML: {error}", path=origin) from error
    except msgspec.ValidationError as error:
        raise BlueprintError(f"{origin}: {error}", path=origin) from error
    blueprint = msgspec.structs.replace(blueprint, hash=hashlib.sha256(raw).hexdigest())
    try:
        check_rules(blueprint)
    except BlueprintError as error:
        raise BlueprintError(f"{origin}: {error.text}", **error.fields) from error
    return blueprint
