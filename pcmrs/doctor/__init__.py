"""Checks that a machine has what a cell needs, before anything moves: `pcmrs doctor`."""

from pcmrs.doctor.check_result import CheckResult
from pcmrs.doctor.examination import Examination, examine

__all__ = ["CheckResult", "Examination", "examine"]
