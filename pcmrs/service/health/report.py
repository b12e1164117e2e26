"""Verdict on the daemon's health: pure functions of the facts."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import msgspec

from pcmrs.messages.health import Health, HealthFacts, HealthReason, HealthStatus, Severity
from pcmrs.service.watches.stall import STALL

SLOW_DISK = 1.0
"""Limit of a row's wait for the disk, s of the machine."""
STUCK_DISK = 10.0
"""Wait after which the journal's writer counts as stuck, s of the machine."""
SILENCE = 1.0
"""Time without heartbeats after which a node counts as silent, s of the machine."""
FILLING = 0.8
"""Fraction of a queue's limit from which it is about to refuse."""

ENDS_SOON = 3 * 86400.0
"""Time before the end of a certificate from which that is reported, s."""

RESTART_HELPS = ("journal_stuck", "task_stuck")
"""Codes of the reasons that only a restart repairs: then the daemon stops feeding the watchdog."""


def report(facts: HealthFacts) -> Health:
    """Return the facts with the verdict on them."""
    found = reasons(facts)
    severities = {reason.severity for reason in found}
    status: HealthStatus = "failed" if "failed" in severities else "degraded" if severities else "ok"
    return Health(status=status, reasons=found, **msgspec.structs.asdict(facts))


def reasons(facts: HealthFacts) -> list[HealthReason]:
    """Return the reasons why the daemon is not well, the worst first."""
    found = [*_of_dispatcher(facts), *_of_journal(facts), *_of_tasks(facts), *_of_devices(facts), *_of_rest(facts)]
    return sorted(found, key=lambda reason: reason.severity != "failed")


def needs_restart(found: Sequence[HealthReason]) -> bool:
    """Return whether a service manager should restart the daemon.

    A journal that cannot be written is not a reason: Stop still works then, and the daemon reopens the journal by
    itself as soon as the disk allows it.
    """
    return any(reason.code in RESTART_HELPS for reason in found)


def _of_dispatcher(facts: HealthFacts) -> Iterator[HealthReason]:
    if facts.in_doubt:
        text = "Robot or stimulator have not confirmed that they are stopped."
        yield _failed("hold_not_confirmed", text, "Look, and use their own emergency stop; then acknowledge.")
    if facts.fail_stop and not facts.journal.failure:
        yield _failed("fail_stop", facts.fail_stop, "Restart the daemon, unless it goes on by itself.")


def _of_journal(facts: HealthFacts) -> Iterator[HealthReason]:
    journal = facts.journal
    waited = f"A row of the journal has waited for the disk for {journal.oldest_wait:.1f} s"
    if journal.failure:
        remedy = "See to the disk: the daemon takes the journal up again by itself as soon as it can be written."
        yield _failed("journal_failed", journal.failure, remedy)
    elif journal.oldest_wait > STUCK_DISK:
        yield _failed("journal_stuck", f"{waited}: its writer is stuck.", "Look to the disk, then restart the daemon.")
    elif journal.oldest_wait > SLOW_DISK:
        yield _degraded("journal_slow", f"{waited}.", "See what else writes to that disk; use a quicker one.")
    if journal.room != "enough":
        text = f"{(journal.free or 0.0) / 1e6:.0f} MB are free on the disk of the journal"
        if journal.room == "none":
            remedy = "Make room on the disk of cell.folder; commands are taken again by themselves."
            yield _failed("disk_full", f"{text}: no state change is accepted but retreats.", remedy)
        else:
            yield _degraded("disk_filling", f"{text}.", "Make room on the disk of cell.folder.")


def _of_tasks(facts: HealthFacts) -> Iterator[HealthReason]:
    for task in facts.tasks:
        if not task.answers:
            text = f"The daemon's task '{task.name}' is stuck."
            yield _failed("task_stuck", text, "Restart the daemon.")


def _of_devices(facts: HealthFacts) -> Iterator[HealthReason]:
    gone = {device for node in facts.nodes if node.given_up for device in node.devices}
    for node in facts.nodes:
        if node.given_up:
            text = f"The node of {', '.join(node.devices)} has ended too often and is not restarted."
            yield _failed("node_given_up", text, "The log says why it ends: fix that and restart the daemon.")
    heard = [device for device in facts.devices if device.device not in gone]
    silent = [device for device in heard if device.heard is not None and device.heard > SILENCE]
    if silent:
        longest = max(device.heard or 0.0 for device in silent)
        text = f"No heartbeat of {', '.join(device.device for device in silent)} for up to {longest:.1f} s."
        yield _degraded("node_silent", text, "See whether the node's process runs and how busy its machine is.")
    for device in heard:
        if not device.connected and device not in silent:
            text = f"{device.device} is not connected: {device.text or 'its node does not say why.'}"
            yield _degraded("device_not_connected", text, "See to its power, cable and address; docs/devices.md.")


def _of_rest(facts: HealthFacts) -> Iterator[HealthReason]:
    if facts.loop.lag > STALL:
        text = f"The event loop answered {facts.loop.lag:.2f} s late; {STALL:g} s is the limit."
        yield _degraded("loop_late", text, "Take load off the machine; the log says what the loop was at.")
    for queue in facts.queues:
        if queue.depth >= FILLING * queue.limit:
            text = f"{queue.depth} wait in the queue '{queue.queue}', which holds {queue.limit}."
            yield _degraded("queue_filling", text, "See who sends so much; what does not fit is refused.")
    if facts.recording:
        text = f"The session is not recorded any more: {facts.recording}."
        yield _degraded("recording_ended", text, "The log says why; the journal is not concerned.")
    if facts.console:
        text = f"The page is not served any more: {facts.console}."
        yield _degraded("console_ended", text, "The log says why; if its port is taken, set another console.port.")
    if facts.certificate is not None and facts.certificate < ENDS_SOON:
        text = f"The daemon's certificate ends in {facts.certificate / 3600.0:.0f} h; then no other machine reaches it."
        yield _degraded("certificate_ends", text, "Have a new one issued, `pcmrs pki issue`, and restart the daemon.")
    if facts.metrics:
        yield _degraded("metrics_not_served", facts.metrics, "Give another metrics.port and restart the daemon.")


def _failed(code: str, text: str, remedy: str) -> HealthReason:
    return _reason("failed", code, text, remedy)


def _degraded(code: str, text: str, remedy: str) -> HealthReason:
    return _reason("degraded", code, text, remedy)


def _reason(severity: Severity, code: str, text: str, remedy: str) -> HealthReason:
    return HealthReason(severity=severity, code=code, text=text, remedy=remedy)
