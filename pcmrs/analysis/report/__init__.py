"""The report of a session: one page of HTML with its pictures in it, that needs no script and nothing from outside."""

from pcmrs.analysis.report.figures import draw_figures
from pcmrs.analysis.report.page import render_report

__all__ = ["draw_figures", "render_report"]
