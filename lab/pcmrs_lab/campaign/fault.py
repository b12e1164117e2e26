"""Registry of fault injections: functions registered under the ids of the catalogue.

@fault("S3", how="simulated tracker: a position that is not a number")
async def pose_nan(lab: Lab) -> Evidence:
    ...
"""

from __future__ import annotations

import math
from collections.abc import Awaitable, Callable, Iterable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final, Literal

from pcmrs.errors import ConfigurationError, PcmrsError
from pcmrs.testing.needs import Need
from pcmrs_lab.campaign.catalogue import FaultClass, catalogue
from pcmrs_lab.campaign.tries import Try, declared

if TYPE_CHECKING:
    from pcmrs_lab.campaign.lab import Lab

DEADLINE = 120.0
"""Time after which an injection that has not ended counts as failed, s of the machine."""


class NotRun(PcmrsError):  # noqa: N818 - see above
    """The fault cannot be injected on this machine; the text gives the reason."""

    code = "not_run"


ControlKind = Literal["permitted", "mutant", "without_fault"]
"""Kind of a row's control.

permitted: The same command or message has its effect where it is permitted: from a permitted identity, or in a state or
    plan that permits it.
mutant: The same input has its effect on a program without the guard (`without_guard`), never by a setting of the
    product.
without_fault: The same command has its effect in the same run when the fault is absent, so the response is due to the
    fault.
"""

SENDERS: Final[tuple[FaultClass, ...]] = ("operator", "adversary")
"""Classes whose faults are input of a person or program. For them `without_fault` proves nothing: that another input
has its effect does not show that this one would have had any."""


@dataclass(frozen=True, slots=True)
class Evidence:
    """Measurements of an injected fault and its response; a row without them proves nothing.

    Attributes:
        response: Response in a few words.
        details: Other measured values.
        took_place: Measurements of the fault itself, by name, made by the receiver or another observer, never by the
            injector.
        control: Measured effects of the control, by name.
        control_kind: Kind of the control.
    """

    response: str
    details: Mapping[str, Any] = field(default_factory=dict)
    took_place: Mapping[str, Any] = field(kw_only=True)
    control: Mapping[str, Any] = field(kw_only=True)
    control_kind: ControlKind = field(kw_only=True)

    def missing(self, fault_class: FaultClass) -> str:
        """Return what is missing of the proof; empty if it is complete. A measurement of 0, none or empty is none.

        Args:
            fault_class: Class of the fault.
        """
        if not self.response.strip():
            return "There is no response."
        for what, measured in (("that the fault took place", self.took_place), ("of its control", self.control)):
            if not measured:
                return f"There is no measurement {what}."
            nothing = [name for name, value in measured.items() if not _is_something(value)]
            if nothing:
                return f"The measurement {what} is of nothing: {', '.join(nothing)}."
        if self.control_kind == "without_fault" and fault_class in SENDERS:
            return (
                f"The control of a fault of the class {fault_class} must be the same input where it is permitted, or "
                "a mutant without the guard."
            )
        return ""

    @property
    def measured(self) -> dict[str, Any]:
        """All measurements, for a report."""
        control = {"control": dict(self.control), "control_kind": self.control_kind}
        return {"took_place": dict(self.took_place), **control, **self.details}


def _is_something(value: Any) -> bool:
    """Return whether a value is a measurement; a number that is not finite is none."""
    return bool(value) and not (isinstance(value, float) and not math.isfinite(value))


Injector = Callable[["Lab"], Awaitable[Evidence]]


@dataclass(frozen=True, slots=True)
class Injection:
    """One way to inject a fault.

    Attributes:
        fault: Id of the catalogue.
        name: Name of the function.
        how: Means of injection, for the report.
        needs: Requirements on the machine; it is not run if one is missing.
        deadline: Time after which it counts as failed, s of the machine.
        run: Function that injects the fault and checks the response; raises `Unmet` or `NotRun`.
        tries: Attacks that it tries, which `pcmrs_lab.campaign.tries` records; empty if it is not compared.
    """

    fault: str
    name: str
    how: str
    needs: tuple[Need, ...]
    deadline: float
    run: Injector
    tries: frozenset[Try] = frozenset()


REGISTERED: dict[str, list[Injection]] = {}
"""Injections by the id of their fault, of the modules that are loaded; see `injections`."""


def fault(
    fault_id: str,
    *,
    how: str,
    needs: Iterable[Need] = (),
    deadline: float = DEADLINE,
    tries: Mapping[str, Iterable[str]] = MappingProxyType({}),
) -> Callable[[Injector], Injector]:
    """Register a way to inject a fault; several may be registered under one id, and all must pass.

    Args:
        fault_id: Id of the catalogue.
        how: Means of injection, for the report.
        needs: Requirements on the machine.
        deadline: Time after which it counts as failed, s of the machine.
        tries: Entry points that it attacks, by attacker; see `pcmrs_lab.campaign.tries`.

    Raises:
        ConfigurationError: The id is not in the catalogue.
    """
    if fault_id not in catalogue():
        raise ConfigurationError(f"The catalogue has no fault {fault_id}.", fault=fault_id)

    def register(run: Injector) -> Injector:
        name = getattr(run, "__name__", fault_id)
        injection = Injection(fault_id, name, how, tuple(needs), deadline, run, declared(tries))
        REGISTERED.setdefault(fault_id, []).append(injection)
        return run

    return register
