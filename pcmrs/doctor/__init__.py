"""Checks that a machine has what a cell needs, before anything moves: `pcmrs doctor`."""

from pcmrs.doctor._check_result import CheckResult
from pcmrs.doctor._examination import Examination, examine

__all__ = ["CheckResult", "Examination", "examine"]
