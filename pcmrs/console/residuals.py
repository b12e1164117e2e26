"""How well the registration in force fits: the mean of its landmarks and each of them, against the limit, in words."""

from __future__ import annotations

from nicegui import ui

from pcmrs.console.geometry import residuals
from pcmrs.console.texts import Texts
from pcmrs.console.told import NOTHING, Told
from pcmrs.messages.setup import Gathered, Setup


class ResidualsShown:
    """A line and one chip for each landmark; nothing while nothing is registered.

    Args:
        told: What is shown.
        setup: Of the cell.
        texts: Of the page's language.
    """

    def __init__(self, told: Told, setup: Setup, texts: Texts) -> None:
        self._told, self._limit, self._texts = told, setup.residual_limit, texts
        self._drawn = NOTHING
        with ui.column().classes("gap-1") as self._whole:
            self._mean = ui.label().props('data-testid="residual"')
            self._each = ui.row().classes("gap-1").props('data-testid="landmark-residuals"')
        self._whole.set_visibility(False)

    def refresh(self) -> None:
        """Shows what is now."""
        data = self._told.data
        if data == self._drawn:
            return
        self._drawn = data
        self._whole.set_visibility(data.residual is not None)
        self._mean.set_text(mean_in_words(data, self._limit, self._texts))
        self._each.clear()
        with self._each:
            for words, is_good in each_in_words(data, self._limit, self._texts):
                ui.badge(words, color="green-9" if is_good else "deep-orange-10").classes("text-body2")


def mean_in_words(data: Gathered, limit: float, texts: Texts) -> str:
    """The mean of all landmarks against its limit, m; empty while nothing is registered."""
    if data.residual is None:
        return ""
    return texts("residual", mm=1000.0 * data.residual, limit=1000.0 * limit)


def each_in_words(data: Gathered, limit: float, texts: Texts) -> list[tuple[str, bool]]:
    """Each landmark that has a residual, in the order of the plan, and whether that is within the limit, m."""
    return [
        (
            texts(
                "landmark_within" if residual <= limit else "landmark_beyond",
                name=landmark.name,
                mm=1000.0 * residual,
                limit=1000.0 * limit,
            ),
            residual <= limit,
        )
        for landmark, residual in zip(data.landmarks, residuals(data), strict=True)
        if residual is not None
    ]
