"""How a fault is injected and judged: functions registered under the ids of the catalogue.

@fault("S3", how="simulated tracker: a position that is not a number")
async def pose_nan(lab: Lab) -> Evidence:
    ...
"""

from __future__ import annotations

import math
from collections.abc import Awaitable, Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from pcmrs.errors import ConfigurationError, PcmrsError
from pcmrs_lab.campaign.catalogue import catalogue
from pcmrs_lab.campaign.needs import Need

if TYPE_CHECKING:
    from pcmrs_lab.campaign.lab import Lab

DEADLINE = 120.0
"""An injection that has not ended within this has failed, s of the machine."""


class NotRun(PcmrsError):  # noqa: N818 - see above
    """The fault cannot be injected on this machine; the text says why."""

    code = "not_run"


@dataclass(frozen=True, slots=True)
class Evidence:
    """What was seen when a fault was injected and the required response came; without any of it nothing is proved.

    Attributes:
        response: In a few words.
        details: Other measured values.
        took_place: What the receiver, or somebody else who is not the injector, has measured of the fault, by name.
        control: What the same bytes or the same event do where they are permitted, or where the protection is out of
            force, by name.
    """

    response: str
    details: Mapping[str, Any] = field(default_factory=dict)
    took_place: Mapping[str, Any] = field(kw_only=True)
    control: Mapping[str, Any] = field(kw_only=True)

    @property
    def missing(self) -> str:
        """What it lacks for a proof; empty when nothing does. A measurement of nothing (0, none, empty) is none."""
        for what, measured in (("that the fault took place", self.took_place), ("of its control", self.control)):
            if not measured:
                return f"There is no measurement {what}."
            nothing = [name for name, value in measured.items() if not _is_something(value)]
            if nothing:
                return f"The measurement {what} is of nothing: {', '.join(nothing)}."
        return ""

    @property
    def measured(self) -> dict[str, Any]:
        """All of it, for a report."""
        return {"took_place": dict(self.took_place), "control": dict(self.control), **self.details}


def _is_something(value: Any) -> bool:
    """A number that is not finite was not measured."""
    return bool(value) and not (isinstance(value, float) and not math.isfinite(value))


Injector = Callable[["Lab"], Awaitable[Evidence]]


@dataclass(frozen=True, slots=True)
class Injection:
    """One way in which a fault is injected.

    Attributes:
        fault: Id of the catalogue.
        name: Of the function.
        how: By what means.
        needs: What it needs of the machine; without one of them it is not run.
        deadline: It has failed when it has not ended within this, s of the machine.
        run: Injects the fault, checks the response; raises `Unmet` or `NotRun`.
    """

    fault: str
    name: str
    how: str
    needs: tuple[Need, ...]
    deadline: float
    run: Injector


REGISTERED: dict[str, list[Injection]] = {}
"""Id to the ways in which that fault is injected, as far as their modules are loaded; see `injections`."""


def fault(
    fault_id: str, *, how: str, needs: Iterable[Need] = (), deadline: float = DEADLINE
) -> Callable[[Injector], Injector]:
    """Registers a way to inject a fault; several may be registered under one id, and all must pass.

    Args:
        fault_id: Of the catalogue.
        how: By what means it is injected, for the report.
        needs: What it needs of the machine.
        deadline: It has failed when it has not ended within this, s of the machine.

    Raises:
        ConfigurationError: The catalogue has no such id.
    """
    if fault_id not in catalogue():
        raise ConfigurationError(f"The catalogue has no fault {fault_id}.", fault=fault_id)

    def register(run: Injector) -> Injector:
        name = getattr(run, "__name__", fault_id)
        REGISTERED.setdefault(fault_id, []).append(Injection(fault_id, name, how, tuple(needs), deadline, run))
        return run

    return register
