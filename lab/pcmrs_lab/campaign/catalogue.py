"""The fault catalogue: every fault, what is required of the system, and what the reference implementation does."""

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
"""What the letters in `CatalogueRow.required` mean."""


class CatalogueRow(msgspec.Struct, frozen=True, forbid_unknown_fields=True, rename={"fault_class": "class"}):
    """One fault of the catalogue.

    Attributes:
        id: Letter of its class and number, such as ``S3``.
        fault_class: Who or what fails.
        title: What happens.
        required: The response, in words and in the letters of `RESPONSES`.
        reference: What the reference implementation does instead; empty where nothing wrong is known of it.
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
    """All rows by id, in the catalogue's order."""
    text = files("pcmrs_lab.campaign").joinpath("catalogue.toml").read_text(encoding="utf-8")
    rows = msgspec.convert(tomllib.loads(text), _File).faults
    return {row.id: row for row in rows}


def choose(classes: Collection[str] = (), ids: Collection[str] = ()) -> list[CatalogueRow]:
    """The rows of these classes and these ids together; all where neither is named.

    Raises:
        ConfigurationError: There is no such class or id.
    """
    rows = catalogue()
    _refuse_unknown("class", set(classes) - set(CLASSES), ", ".join(CLASSES))
    _refuse_unknown("fault", set(ids) - rows.keys(), "`pcmrs faults list` has them all")
    everything = not classes and not ids
    return [row for row in rows.values() if everything or row.fault_class in classes or row.id in ids]


def _refuse_unknown(what: str, names: Collection[str], known: str) -> None:
    if names:
        text = f"There is no {what} {', '.join(sorted(names))} in the catalogue: {known}."
        raise ConfigurationError(text, unknown=sorted(names))
