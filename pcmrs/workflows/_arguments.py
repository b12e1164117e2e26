"""Arguments that several operations share, and checks of them."""

from __future__ import annotations

from typing import Annotated

import msgspec
import numpy as np
import numpy.typing as npt

from pcmrs.errors import RefusalError

NAME = r"\A(?=.*\w)[^\x00-\x1f\x7f-\x9f\u2028\u2029\u202a-\u202e\u2066-\u2069]+\Z"
"""At least one letter or digit, and no control characters, which could forge another line or place of a record."""

PersonName = Annotated[str, msgspec.Meta(max_length=100, pattern=NAME)]
"""Name of a person, as commands give it and records show it."""

MAX_COORDINATE = 1.0
"""Largest plausible coordinate in the image, m. A larger one was probably given in mm."""


def check_metres(points: npt.ArrayLike) -> None:
    """Refuse coordinates in the image, (..., 3), that are too large to be in m. Raises `RefusalError`."""
    farthest = float(np.abs(points).max())
    if farthest > MAX_COORDINATE:
        text = f"A coordinate is {farthest:g} m; the limit is {MAX_COORDINATE:g} m. Were these millimetres?"
        raise RefusalError("wrong_unit", text, value=farthest, limit=MAX_COORDINATE)


class Retreat(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Arguments of `back_off`, `home` and `to_initial`.

    Attributes:
        confirm: True if a person has looked at the whole path of the arm. It is needed if no registration shows the
            place of the body.
    """

    confirm: bool = False
