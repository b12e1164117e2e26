"""Fonts of the system, which pictures of charts need."""

from __future__ import annotations

import pytest

from pcmrs.authoring.chart import png, svg
from pcmrs.errors import ConfigurationError
from pcmrs.fsm.blueprint import Blueprint, BranchSpec


def skip_without_font() -> None:
    """Skip a test if the system has no font: a picture's texts need one, and a bare system has none."""
    try:
        png(svg(Blueprint(id="x", version="1", branches={"b": BranchSpec(states={"a": ""})})))
    except ConfigurationError as error:
        pytest.skip(f"{error.text}")
