"""Mean, standard deviation and maximum of a series."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt


@dataclass(frozen=True, slots=True)
class Summary:
    """What a series comes to, in its own unit.

    Attributes:
        sd: Standard deviation of a sample (n - 1); None for one value, which has none.
    """

    mean: float
    sd: float | None
    max: float


def summarize(values: npt.ArrayLike) -> Summary:
    """Of one or more values (N,)."""
    series = np.asarray(values, dtype=float)
    sd = float(series.std(ddof=1)) if len(series) > 1 else None
    return Summary(float(series.mean()), sd, float(series.max()))
