"""Small programs that run at a place of the lab of namespaces, and what they say."""

from __future__ import annotations

import subprocess
import sys

from pcmrs.testing.natlab import NatLab, Place


def python(lab: NatLab, place: Place, program: str, *arguments: str) -> subprocess.Popen[str]:
    """Starts a program given as text."""
    pipe = subprocess.PIPE
    return lab.start(place, sys.executable, "-c", program, *arguments, stdin=pipe, stdout=pipe)


def said(process: subprocess.Popen[str]) -> str:
    """Its next line."""
    assert process.stdout is not None
    return process.stdout.readline().strip()
