"""What all figures share: size, colours that colour-blind people tell apart, and how they are saved."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    # For annotations only: what draws nothing must not load matplotlib.
    from matplotlib.figure import Figure

BLUE, ORANGE, GREEN = "#0072B2", "#D55E00", "#009E73"
"""Okabe, Ito, Color Universal Design (2008)."""

DPI = 150


def new_figure(width: float = 10.0, height: float = 4.5) -> Figure:
    """An empty figure, `width` by `height` inches, that makes room for its labels."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def save_png(figure: Figure, path: Path) -> None:
    """Writes the figure as a PNG file. Raises `OSError` when that cannot be written."""
    figure.savefig(path, format="png", dpi=DPI)
