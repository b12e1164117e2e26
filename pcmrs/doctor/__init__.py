"""Checks that a machine has what a cell needs, before anything moves: `pcmrs doctor`."""

from pcmrs.doctor.examination import Examination, examine
from pcmrs.doctor.finding import CheckResult

__all__ = ["CheckResult", "Examination", "examine"]
