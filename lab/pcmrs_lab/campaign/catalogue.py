"""Fault catalogue: each fault, the required response, and the behaviour of the reference implementation."""

from __future__ import annotations

import tomllib
from collections.abc import Collection, Mapping
from functools import cache
from importlib.resources import files
from typing import Literal, get_args

import msgspec

from pcmrs.errors import ConfigurationError

FaultClass = Literal["operator", "sensor", "robot", "network", "process", "storage", "clock", "adversary", "order"]
CLASSES: tuple[FaultClass, ...] = get_args(FaultClass)

RESPONSES: Mapping[str, str] = {
    "R": "refused with a typed reason, states and data byte-identical, a row in the journal",
    "H": "motion stopped and latched until an operator has confirmed",
    "D": "new changes of state refused, Stop and status still work",
    "U": "outcome unknown: the hardware is asked, nothing is repeated blindly",
}
"""Meaning of the letters in `CatalogueRow.required`."""


class CatalogueRow(msgspec.Struct, frozen=True, forbid_unknown_fields=True, rename={"fault_class": "class"}):
    """One fault of the catalogue.

    Attributes:
        id: Letter of its class and number, such as ``S3``.
        fault_class: Person or part of the system that fails.
        title: Description of the fault.
        required: Required response, in words and in the letters of `RESPONSES`.
        reference: Known wrong behaviour of the reference implementation; empty if none is known.
    """

    id: str
    fault_class: FaultClass
    title: str
    required: str
    reference: str = ""


class _File(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    faults: list[CatalogueRow]


@cache
def catalogue() -> Mapping[str, CatalogueRow]:
    """Return all rows by id, in the order of the catalogue."""
    text = files("pcmrs_lab.campaign").joinpath("catalogue.toml").read_text(encoding="utf-8")
    rows = msgspec.convert(tomllib.loads(text), _File).faults
    return {row.id: row for row in rows}


def choose(classes: Collection[str] = (), ids: Collection[str] = ()) -> list[CatalogueRow]:
    """Return the rows of these classes and of these ids; all rows if neither is given.

    Args:
        classes: Classes from `CLASSES`.
        ids: Ids of rows.

    Raises:
        ConfigurationError: A class or an id is unknown.
    """
    rows = catalogue()
    _refuse_unknown("class", set(classes) - set(CLASSES), ", ".join(CLASSES))
    _refuse_unknown("fault", set(ids) - rows.keys(), "`pcmrs faults list` shows all ids")
    everything = not classes and not ids
    return [row for row in rows.values() if everything or row.fault_class in classes or row.id in ids]


def _refuse_unknown(what: str, names: Collection[str], known: str) -> None:
    if names:
        text = f"Unknown {what} {', '.join(sorted(names))}: {known}."
        raise ConfigurationError(text, unknown=sorted(names))
