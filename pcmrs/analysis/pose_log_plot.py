"""A pose log as a picture: how each pose moves around its mean."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pcmrs.analysis.plots import BLUE, GREEN, ORANGE, new_figure
from pcmrs.analysis.pose_log import seen
from pcmrs.formats.pose_log import PoseLog

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def pose_log_figure(log: PoseLog) -> Figure:
    """One panel per row name: translation against its median, per axis in mm; gaps stay gaps."""
    figure = new_figure(height=7.0)
    figure.suptitle(log.name)
    panels = figure.subplots(len(log.poses), 1, sharex=True)
    missing = np.full(3, np.nan)
    for axes, (name, poses) in zip(panels, log.poses.items(), strict=True):
        tracked = seen(poses)
        translations = np.array([missing if pose is None else pose.translation for pose in tracked])
        axes.set_ylabel(f"{name}, mm")
        if any(pose is not None for pose in tracked):
            deviations_mm = (translations - np.nanmedian(translations, axis=0)) * 1000.0
            for axis, color, values in zip("xyz", (BLUE, ORANGE, GREEN), deviations_mm.T, strict=True):
                axes.plot(values, ".-", color=color, label=axis, linewidth=0.8, markersize=3.0)
    panels[0].legend(loc="upper right", ncols=3)
    panels[-1].set_xlabel("sample")
    return figure
