"""How often a property is tried: a test that needs more or fewer examples than most says so; profiles scale it."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import settings

USUAL = 25
"""Examples of a property in `make test`."""


def examples(number: int, **options: Any) -> settings:
    """`number` examples in `make test`, and as many times more as a profile has more than `USUAL`.

    Args:
        number: In `make test`.
        options: Others of `hypothesis.settings`.
    """
    return settings(max_examples=max(1, number * settings().max_examples // USUAL), **options)


def run_counts(usual: int, nightly: int) -> pytest.MarkDecorator:
    """Return the parameter `runs` of a test that draws by itself.

    Args:
        usual: Number of runs in `make test`.
        nightly: Number of runs in `make nightly`.
    """
    return pytest.mark.parametrize("runs", [usual, pytest.param(nightly, marks=pytest.mark.nightly)])
