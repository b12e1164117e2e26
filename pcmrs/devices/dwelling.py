"""When a tip that is held still is a touch, as the configuration says it."""

from __future__ import annotations

from typing import Annotated

import msgspec

Positive = Annotated[float, msgspec.Meta(gt=0.0)]


class DwellSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """When a tip that is held still is a touch.

    Attributes:
        time: It is held still for so long, s; well within what is kept of the poses.
        still_mm: It stays within so much of where it is now.
        samples: The tracker has seen it there at least so often.
        away_mm: Before that it was farther than this from where it was at the prompt, or from the last touch.
    """

    time: Annotated[float, msgspec.Meta(gt=0.0, le=3.0)] = 0.8
    still_mm: Positive = 1.0
    samples: Annotated[int, msgspec.Meta(ge=2)] = 10
    away_mm: Positive = 10.0
