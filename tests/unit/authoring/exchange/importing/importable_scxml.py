"""Imports SCXML that must be importable."""

from __future__ import annotations

from pcmrs.authoring.exchange.importing.scxml import from_scxml
from pcmrs.fsm import Blueprint


def importable(inside: str, **given: str) -> Blueprint:
    attributes = "".join(f' {key}="{value}"' for key, value in given.items())
    blueprint, findings = from_scxml(f"<scxml{attributes}>{inside}</scxml>".encode())
    assert blueprint is not None, findings
    return blueprint
