"""Errors of `pcmrs.testing`."""

from __future__ import annotations

from pcmrs.errors import PcmrsError

__all__ = ["Unmet"]


class Unmet(PcmrsError):  # noqa: N818 - what a test finds, not an error of the program
    """The required response was not observed; the text names what was observed instead."""

    code = "response_unmet"
