"""How many examples a property is tried with: a test that needs more or fewer than most says so; profiles scale it."""

from __future__ import annotations

from typing import Any

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
