"""All checks, and their verdict."""

from __future__ import annotations

from collections.abc import Iterator

from pcmrs.doctor._check_result import CheckResult, CheckVerdict
from pcmrs.doctor._disk import disk, free_space
from pcmrs.doctor._machine import clock_source, kernel, limits, scheduling, uploads
from pcmrs.doctor._surroundings import certificates, devices, extras, is_running, motion, peers, ports, streams
from pcmrs.messages import Message
from pcmrs.settings import Settings


class Examination(Message, frozen=True, kw_only=True, omit_defaults=False):
    """Result of all checks of a machine.

    Attributes:
        verdict: The worst of the findings.
        findings: Findings in the order of the checks.
    """

    verdict: CheckVerdict
    findings: list[CheckResult]


def examine(settings: Settings) -> Examination:
    """Check this machine for the cell of a configuration, without changing anything or sending anything to a device.

    Args:
        settings: Settings of the cell.
    """
    findings = list(_findings(settings))
    verdicts = {finding.verdict for finding in findings}
    verdict: CheckVerdict = "bad" if "bad" in verdicts else "warning" if "warning" in verdicts else "good"
    return Examination(verdict=verdict, findings=findings)


def _findings(settings: Settings) -> Iterator[CheckResult]:
    running, folder = is_running(settings), settings.cell.path()
    yield from scheduling()
    yield from kernel()
    yield from limits()
    yield from clock_source()
    yield from disk(folder)
    yield from free_space(folder, settings.journal.warn_free_mb * 1e6, settings.journal.least_free_mb * 1e6)
    yield from ports(settings, running=running)
    yield from extras(settings)
    yield from devices(settings, running=running)
    yield from motion(settings)
    yield from streams(settings)
    yield from peers(settings)
    yield from certificates(settings)
    if settings.console.enabled:
        yield from uploads()
