"""Arguments of the operations that bring the tool away from the body.

Names of people, as commands give them and records show them.

Whether coordinates can be in m.
"""

from __future__ import annotations

from typing import Annotated

import msgspec
import numpy as np
import numpy.typing as npt

from pcmrs.errors import RefusalError

NAME = r"\A(?=.*\w)[^\x00-\x1f\x7f-\x9f\u2028\u2029\u202a-\u202e\u2066-\u2069]+\Z"
"""Something to read, and nothing that would write on another line or place of a record: no control characters."""

PersonName = Annotated[str, msgspec.Meta(max_length=100, pattern=NAME)]


MAX_COORDINATE = 1.0
"""A coordinate farther than this from the origin of the image (m) was probably given in mm."""


def check_metres(points: npt.ArrayLike) -> None:
    """Refuses coordinates in the image that are too large to be in m, (..., 3). Raises `RefusalError`."""
    farthest = float(np.abs(points).max())
    if farthest > MAX_COORDINATE:
        text = f"A coordinate is {farthest:g} m; the limit is {MAX_COORDINATE:g} m. Were these millimetres?"
        raise RefusalError("wrong_unit", text, value=farthest, limit=MAX_COORDINATE)


class Retreat(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Arguments of `back_off`, `home` and `to_initial`.

    Attributes:
        confirm: Somebody has looked at the whole way; it is needed where no registration tells where the body is.
    """

    confirm: bool = False
