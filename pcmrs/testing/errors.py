"""Errors of `pcmrs.testing`."""

from __future__ import annotations

from pcmrs.errors import PcmrsError


class Unmet(PcmrsError):  # noqa: N818 - what a test finds, not an error of the program
    """The required response was not seen; the text says what was seen instead."""

    code = "response_unmet"
