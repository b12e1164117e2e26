"""Registration of the digitized landmarks, and reuse of an earlier registration."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np

from pcmrs.dispatcher import Registry
from pcmrs.dispatcher import Run as AnyRun
from pcmrs.errors import RefusalError
from pcmrs.registration import PointRegistration, RegistrationGate, RegistrationVerdict, judge
from pcmrs.spatial import Transform
from pcmrs.workflows._landmarks import check_same_head
from pcmrs.workflows.accuracy import active_limits, learn_noise
from pcmrs.workflows.cell import Cell
from pcmrs.workflows.data import PlacementData, Point, Registered, as_message, as_point
from pcmrs.workflows.reference import RECENT, check_reference

Run = AnyRun[Cell, PlacementData]


def registration_accepted(run: Run) -> None:
    """Register, and refuse a result that does not pass every gate of the verdict."""
    run.prepared, report = judge_landmarks(run)
    run.result |= report


def judge_landmarks(run: Run) -> tuple[PointRegistration, dict[str, Any]]:
    """Return the registration of the digitized landmarks, and its values for the result.

    The target is the planned pose while a plan is in force, otherwise the centroid of the landmarks.

    Raises:
        RefusalError: A gate does not pass. The code is the name of the gate.
    """
    data, limits = run.data, active_limits(run.cell, run.data)
    planned = np.array([landmark.position for landmark in data.landmarks])
    names = [landmark.name for landmark in data.landmarks]
    target = _planned_position(run)
    verdict = judge(planned, data.complete_digitization(), limits, names=names, target=target)
    registration = verdict.registration
    if registration is None or not verdict.accepted:
        raise _refused(verdict, names)
    at, position = ("centroid", as_point(planned.mean(axis=0))) if target is None else ("plan", target)
    return registration, {
        "residual": registration.residual,
        "rms": registration.rms,
        "distances": registration.distances.tolist(),
        "limit": limits.residual,
        "tre": verdict.tre,
        "target": {"at": at, "position": position},
        "sigma": limits.sigma,
        "gates": [_gate_values(gate) for gate in verdict.gates],
        "witness": data.reference is not None,
    }


def _planned_position(run: Run) -> Point | None:
    """Return the position of the plan in force in the image, m; None without a plan."""
    plan = run.data.plan
    return plan.position if plan is not None and run.states.get("toolplan", "1") == "1" else None


def keep_registration(run: Run) -> None:
    """Put the registration in force, and learn the noise from its residuals."""
    fit = run.prepared
    noise = learn_noise(run.cell, run.data, fit.distances)
    activate_registration(run, fit.fixed_from_moving, noise=noise)


def activate_registration(
    run: Run, body_ref_from_image: Transform, *, noise: dict[str, Any], covariance: Any = ()
) -> None:
    """Put a registration of the present digitization in force.

    Args:
        run: Present operation.
        body_ref_from_image: Registration.
        noise: Noise estimates by pointer.
        covariance: Covariance of `Registered`, row by row; empty if no surface has refined the registration.
    """
    data = run.data
    fixed, moving = np.array(data.complete_digitization()), np.array([each.position for each in data.landmarks])
    distances = np.linalg.norm(body_ref_from_image @ moving - fixed, axis=1)
    registered = Registered(
        id=f"registration-{run.command.id}",
        body_ref_from_image=as_message(body_ref_from_image),
        residual=float(distances.mean()),
        rms=float(np.sqrt(np.mean(distances**2))),
        landmarks=data.landmarks,
        digitized=data.complete_digitization(),
        patient=run.cell.settings.patient,
        calibration=run.cell.calibration_id,
        reference=data.reference,
        covariance=tuple(covariance),
        reference_serial=run.cell.settings.calibration.reference_serial,
    )
    run.keep(registered=registered, registration_id=registered.id, previous=registered, noise=noise)


def previous_registration_fits(run: Run) -> None:
    """Refuse a previous registration of another patient or calibration, or of a reference that has moved since."""
    previous = _previous(run)
    check_same_head(run.cell, previous)
    check_reference(run.cell, previous.reference, run.clock.monotonic() - RECENT)


def take_previous_registration(run: Run) -> None:
    """Put the previous registration in force, with its landmarks."""
    previous = _previous(run)
    registered = msgspec.structs.replace(previous, id=f"registration-{run.command.id}")
    run.keep(
        registered=registered,
        registration_id=registered.id,
        previous=registered,
        landmarks=previous.landmarks,
        digitized=previous.digitized,
        reference=previous.reference,
        surface=(),
    )
    run.result |= {"residual": previous.residual, "witness": previous.reference is not None}


def _previous(run: Run) -> Registered:
    previous = run.data.previous
    if previous is None:
        raise RefusalError("no_previous_registration", "No registration was accepted before: register first.")
    return previous


def _gate_values(gate: RegistrationGate) -> dict[str, Any]:
    return {"name": gate.name, "accepted": gate.accepted, "value": gate.value, "limit": gate.limit}


def _refused(verdict: RegistrationVerdict, names: list[str]) -> RefusalError:
    """Return the refusal of the first gate that does not pass, with its values and those of the registration."""
    gate = next(gate for gate in verdict.gates if not gate.accepted)
    fields: dict[str, Any] = {"value": gate.value, "limit": gate.limit}
    fields["gates"] = [_gate_values(each) for each in verdict.gates]
    if verdict.registration is not None:
        worst = names[int(np.argmax(verdict.registration.distances))]
        fields |= {"residual": verdict.registration.residual, "worst": worst}
    if verdict.suspect is not None:
        fields["suspect"] = names[verdict.suspect]
    if verdict.permutation is not None:
        fields["order"] = [names[index] for index in verdict.permutation]
    return RefusalError(gate.name, gate.text, **fields)


def register_registration_operations(registry: Registry[Cell, PlacementData]) -> None:
    """Register the names that blueprints use for these checks and steps."""
    for check in (registration_accepted, previous_registration_fits):
        registry.check(check)
    for step in (keep_registration, take_previous_registration):
        registry.step(step)
