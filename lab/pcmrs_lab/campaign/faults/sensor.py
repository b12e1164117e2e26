"""Sensor faults, injected into the simulated tracker, scene and muscle of a running cell."""

from __future__ import annotations

import asyncio
import hashlib
import math
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from pcmrs.calibration import Calibration, write_calibration
from pcmrs.clock import SystemClock
from pcmrs.devices.ndi.tools import placeholder
from pcmrs.messages import PoseMessage
from pcmrs.testing.arm import stands
from pcmrs.testing.cell import REAL_TIME, RunningCell
from pcmrs.testing.driving import accept, landmarks, reason_text, state, to_placed, to_standoff, until
from pcmrs.testing.errors import Unmet
from pcmrs.workflows.settings import SIMULATED_FLANGE_FROM_TOOL_MARKER, SIMULATED_TOOL_MARKER_FROM_TOOL_TIP
from pcmrs_lab.campaign.checks import confirmed, expect, held, refused
from pcmrs_lab.campaign.driving import FOLLOWED, injected, to_following
from pcmrs_lab.campaign.fault import Evidence, NotRun, fault
from pcmrs_lab.campaign.lab import Lab
from pcmrs_lab.campaign.receivers import flange_forces, forces_over_limit
from pcmrs_lab.campaign.sham import inject_unless_sham, is_sham
from pcmrs_lab.campaign.signs import poses, shown

STALE = 0.9
"""Longer than `procedure.max_pose_age` of any cell here, s of the machine."""

NOT_BELIEVED = ("pose_stale", "pose_missing")


async def no_pose(lab: Lab, name: str, *many: dict[str, Any]) -> Evidence:
    """Check that with the fault no motion to the body is accepted, and without it one is.

    Args:
        lab: Surroundings of the fault.
        name: Name of the fault of the simulated scene.
        many: Arguments of the fault; it is injected once with each.

    Returns:
        Evidence of the row.
    """
    took_place: dict[str, Any] = {}
    async with lab.cell(*REAL_TIME, fresh=False) as cell:
        await to_standoff(cell.client)
        codes: list[str] = []
        for arguments in many or ({},):
            code, seen = await _confirm_refused(cell, name, arguments)
            codes.append(code)
            took_place[" ".join((name, *arguments.values()))] = seen
        await stands(cell)
        control = await accept(cell.client, "placement.confirm")
        reached = await state(cell.client, "placement")
    return Evidence(
        f"confirm refused: {', '.join(dict.fromkeys(codes))}",
        took_place=took_place,
        control_kind="without_fault",
        control={"confirm without the fault": control.decision, "reached": reached},
    )


async def _confirm_refused(cell: RunningCell, name: str, arguments: dict[str, Any]) -> tuple[str, dict[str, float]]:
    """Return the code of the refusal, and a subscriber's observations of the fault."""
    async with poses(cell, arguments.get("body", "*")) as seen, injected(cell, name, arguments):
        await asyncio.sleep(STALE)
        verdict = await refused(cell, "placement.confirm", codes=NOT_BELIEVED)
        took_place = shown(seen, name, arguments)
    await asyncio.sleep(STALE)
    return verdict.reason.code if verdict.reason is not None else "", took_place


def _combine(first: Evidence, second: Evidence) -> Evidence:
    """Return the combined evidence of two faults of one row, each with its own control."""
    return Evidence(
        f"{first.response}; {second.response}",
        took_place={**first.took_place, **second.took_place},
        control_kind="without_fault",
        control={"first": first.control, "second": second.control},
    )


async def following_held(
    lab: Lab, name: str, begin: dict[str, Any] | None = None, end: dict[str, Any] | None = None
) -> Evidence:
    """Check that a tool that follows the head is held at the fault, and stays so after it.

    Args:
        lab: Surroundings of the fault.
        name: Name of the fault of the simulated scene.
        begin: Arguments that inject it, as for `injected`.
        end: Arguments that end it, as for `injected`.

    Returns:
        Evidence of the row.
    """
    arguments = begin or {}
    async with lab.cell(*REAL_TIME, fresh=False) as cell:
        await to_following(cell.client)
        before = await state(cell.client, "placement")
        async with poses(cell, arguments.get("body", "*")) as seen, injected(cell, name, begin, end):
            await held(cell)
            took_place = shown(seen, name, arguments)
        await asyncio.sleep(STALE)
        await confirmed(cell)
    return Evidence(
        "held and latched, confirmed by an operator",
        took_place={name: took_place},
        control_kind="without_fault",
        control={f"{FOLLOWED:g} s before the fault": before},
    )


HOW = "simulated tracker of a running cell"


@fault("S1", how=f"{HOW}: coil hidden before the last motion to the body")
async def occluded(lab: Lab) -> Evidence:
    """There is no motion to the body while coil or body is hidden."""
    return await no_pose(lab, "occlude", {"body": "coil"}, {"body": "body_ref"})


@fault("S1", how=f"{HOW}: body hidden while the tool follows")
async def occluded_while_following(lab: Lab) -> Evidence:
    """A hidden body is not followed."""
    return await following_held(lab, "occlude", {"body": "body_ref"})


@fault("S2", how=f"{HOW}: frames repeat a number; no frames at all")
async def frozen(lab: Lab) -> Evidence:
    """Frames with an old number, and missing frames, count as no pose."""
    return _combine(await no_pose(lab, "frame_frozen"), await no_pose(lab, "tracker_absent"))


@fault("S3", how=f"{HOW}: NaN and infinity in a position")
async def not_finite(lab: Lab) -> Evidence:
    """A position that is not finite counts as no pose."""
    return await no_pose(lab, "pose_nan", {"body": "coil"}, {"body": "body_ref"})


@fault("S4", how=f"{HOW}: a quaternion of length 1.2")
async def not_unit(lab: Lab) -> Evidence:
    """A quaternion of another length than 1 counts as no pose."""
    return await no_pose(lab, "pose_not_unit", {"body": "coil"}, {"body": "body_ref"})


@fault("S5", how=f"{HOW}: the coil, or the body, jumps aside while the tool follows")
async def jump(lab: Lab) -> Evidence:
    """A jump is not followed."""
    body, millimetres = lab.random.choice(("coil", "body_ref")), lab.random.uniform(15.0, 60.0)
    end = {"body": body, "millimetres": 0.0}
    evidence = await following_held(lab, "pose_jump", {"body": body, "millimetres": millimetres}, end)
    return replace(evidence, details={"body": body, "millimetres": millimetres})


@fault("S6", how="simulated scene of a running cell: the reference slips on the patient")
async def bumped(lab: Lab) -> Evidence:
    """The reference has slipped on the patient."""
    millimetres = lab.random.uniform(3.0, 8.0)
    async with lab.cell(*REAL_TIME, fresh=False) as cell:
        await to_placed(cell.client)
        await asyncio.sleep(STALE)
        before, reference = await state(cell.client, "registration"), await _reference_in_image(cell)
        expect(before == "111", "The registration was revoked without the fault.")
        slip, back = {"millimetres": millimetres}, {"millimetres": -millimetres}
        async with injected(cell, "bump_reference", slip, back):
            await until(cell.client, lambda snapshot: snapshot.branches["registration"] == "100")
            slipped = math.dist(reference, await _reference_in_image(cell)) * 1e3
            await held(cell)
        after = await cell.client.state()
        expect((after.registration, after.branches["digitization"]) == (None, "0"), f"Still registered: {after}.")
        await confirmed(cell)
    return Evidence(
        "registration and digitization revoked, held",
        took_place={"slipped_mm": slipped if slipped > 0.5 * millimetres else 0.0},
        control_kind="without_fault",
        control={"registration before the fault": before},
        details={"millimetres": millimetres},
    )


async def _reference_in_image(cell: RunningCell) -> tuple[float, float, float]:
    """Return the true position of the patient in the frame of the reference, m."""
    return (await cell.scene.truth()).body_ref_from_image.position


@fault("S7", how=f"{HOW}: four reasons why a body is not measured, and a bad fit", deadline=180.0)
async def badly_measured(lab: Lab) -> Evidence:
    """The tracker's reasons for a bad measurement are respected."""
    reasons = ("out_of_volume", "partially_out", "temperature", "interference")
    not_measured = await no_pose(lab, "not_measured", *({"body": "coil", "reason": reason} for reason in reasons))
    return _combine(not_measured, await no_pose(lab, "bad_fit", {"body": "coil"}))


@fault("S8", how=f"{HOW}: a reflection moves every other pose; two tools are swapped")
async def mistaken(lab: Lab) -> Evidence:
    """A body is mistaken for something else."""
    phantom = await no_pose(lab, "phantom_marker", {"body": "coil"})
    return _combine(phantom, await no_pose(lab, "tool_swap", {"first": "coil", "second": "body_ref"}))


@fault("S9", how=f"{HOW}: another tool than the defined one is mounted")
async def exchanged_tool(lab: Lab) -> Evidence:
    """The mounted tool is not the defined one."""
    return await no_pose(lab, "wrong_tool", {"body": "coil"})


@fault("S9", how="driver ndi: a tool definition whose hash is not the agreed one", deadline=240.0)
async def wrong_definition(lab: Lab) -> Evidence:
    """The file of the tool is not the agreed one."""
    tool = lab.folder / "coil.rom"
    tool.write_bytes(placeholder("coil"))
    agreed = hashlib.sha256(tool.read_bytes()).hexdigest()
    expected = agreed if is_sham() else f"{lab.seed:064x}"
    settings = ("cell.rate=1", "tracker.driver=ndi", f"ndi.tools.coil={tool}")
    status, errors = await lab.start_refused(*settings, f"ndi.sha256.coil={expected}")
    expect(status == 2 and NOT_AGREED in errors, f"Exit status {status}: {errors[-300:]}")
    async with lab.daemon(*settings, f"ndi.sha256.coil={agreed}") as cell, poses(cell, "coil") as seen:
        control = len(seen.received)
    return Evidence(
        "the daemon does not start, and names the file",
        took_place={"the file's hash differs": agreed != expected, "named": tool.name in errors},
        control_kind="without_fault",
        control={"frames of the coil with the file's own hash": control},
        details={"status": status},
    )


NOT_AGREED = "is not the agreed tool definition"


@fault(
    "S9",
    how="a calibration file that was changed by hand, and one of a tool with another serial number",
    deadline=300.0,
)
async def wrong_calibration(lab: Lab) -> Evidence:
    """The calibration is not that of the mounted tool."""
    file = lab.folder / "tool.toml"
    _write_calibration(file, serial="17")
    tip = SIMULATED_TOOL_MARKER_FROM_TOOL_TIP
    files = (
        f"procedure.calibration.tool_file={file}",
        f"procedure.calibration.tool_marker_from_tool_tip.position={[*tip.position]}",
        f"procedure.calibration.tool_marker_from_tool_tip.quat_wxyz={[*tip.quat_wxyz]}",
    )
    settings = (*files, 'procedure.calibration.tool_serial="17"')
    right = await _digitize_with(lab, settings, "")
    other = settings[-1] if is_sham() else 'procedure.calibration.tool_serial="18"'
    foreign = await _digitize_with(lab, (*files, other), "calibration_foreign")
    before = file.read_text()
    inject_unless_sham(lambda: file.write_text(before.replace("0.138", "0.148")))
    changed = await _digitize_with(lab, settings, "calibration_changed")
    return Evidence(
        f"digitizing refused: {foreign}, {changed}",
        took_place={
            "the daemon reads another serial number": 'serial = "18"' not in before and '"18"' in other,
            "characters changed": sum(a != b for a, b in zip(before, file.read_text(), strict=True)),
        },
        control_kind="without_fault",
        control={"digitize_all with the right file": right},
    )


async def _digitize_with(lab: Lab, settings: tuple[str, ...], code: str) -> str:
    """Digitize with a daemon with these settings, or expect a refusal with `code` if given; return decision or code."""
    async with lab.daemon(*settings) as cell:
        await accept(cell.client, "registration.plan_landmarks", **landmarks())
        if not code:
            return (await accept(cell.client, "digitization.digitize_all")).decision
        verdict = await refused(cell, "digitization.digitize_all", codes=(code,))
        return verdict.reason.code if verdict.reason is not None else ""


def _write_calibration(file: Path, serial: str) -> None:
    """Write a calibration that fits the simulated cell."""
    marker = SIMULATED_FLANGE_FROM_TOOL_MARKER
    calibration = Calibration(
        kind="tool",
        type="coil",
        name="simulated coil",
        serial=serial,
        method="of the simulation",
        date=datetime.fromtimestamp(SystemClock().wall(), UTC),
        valid_days=1,
        error_mm=0.1,
        transforms={"flange_from_tool_marker": PoseMessage(position=marker.position, quat_wxyz=marker.quat_wxyz)},
    )
    write_calibration(file, calibration)


@fault("S10", how=f"{HOW}: 5 frames a second while the tool follows")
async def slow_frames(lab: Lab) -> Evidence:
    """There are too few frames for following."""
    return await following_held(lab, "tracker_rate", {"hertz": 5.0}, {"hertz": 0.0})


@fault("S11", how=f"{HOW}: numbers and stamps run backwards; stamps lie in the future")
async def wrong_stamps(lab: Lab) -> Evidence:
    """Impossible stamps count as no pose."""
    return _combine(await no_pose(lab, "stamp_reversed"), await no_pose(lab, "stamp_future"))


@fault("S13", how="simulated arm: an object pushes the placed tool with 40 N")
async def pushed(lab: Lab) -> Evidence:
    """The force on a tool at rest is over the limit."""
    force = lab.random.uniform(35.0, 50.0)
    async with lab.cell(*REAL_TIME, fresh=False) as cell:
        await to_placed(cell.client)
        await asyncio.sleep(STALE)
        before = await state(cell.client, "placement")
        expect(before == "placed", f"Without the fault it is {before}.")
        async with flange_forces(cell) as forces, injected(cell, "push_tool", {"force": force}, {"force": 0.0}):
            await held(cell)
        await asyncio.sleep(STALE)
        await confirmed(cell)
    return Evidence(
        "held and latched",
        took_place=forces_over_limit(forces, LIMIT),
        control_kind="without_fault",
        control={f"{STALE:g} s before the fault": before},
        details={"newtons": force, "limit": LIMIT},
    )


LIMIT = 25.0
"""Limit of the force on a tool, N."""


ARMED = ("workflow=ratms_threshold", "procedure.alignment.off_time=30", *REAL_TIME)
"""Settings of a cell whose alignment gate tolerates a fault for a while, so that the pulse itself must be refused."""


async def _arm(cell: RunningCell) -> None:
    """Place and align the tool, arm the stimulator at 50 %, and wait for the interval between pulses."""
    await to_placed(cell.client)
    await accept(cell.client, "stimulation.set_ceiling", percent=80.0, operator="simulated operator")
    await accept(cell.client, "stimulation.set_intensity", percent=50.0)
    await until(cell.client, lambda snapshot: snapshot.branches["alignment"] == "1")
    await accept(cell.client, "stimulation.arm")
    await asyncio.sleep(INTERVAL)


async def _fire(cell: RunningCell) -> str:
    """Give a pulse without any fault, and wait for the interval after it.

    Raises:
        NotRun: It was not given: the machine is too busy for frames that are fresh enough.
    """
    verdict = await cell.client.call("stimulation.fire")
    if verdict.decision != "accepted":
        raise NotRun(f"No pulse is given without the fault either: {reason_text(verdict)}")
    await asyncio.sleep(INTERVAL)
    return verdict.decision


INTERVAL = 5.0
"""Longer than the least interval between pulses, s of the cell."""

PULSE_REFUSED = ("coil_off_target", "head_moves", *NOT_BELIEVED)


@fault("S12", how="simulated scene: the head moves at 86 mm/s while the stimulator is armed")
async def dashing_head(lab: Lab) -> Evidence:
    """There is no pulse while the head moves fast."""
    async with lab.daemon(*ARMED) as cell:
        dash = {"millimetres_per_second": 86.0}
        return await _no_pulse(cell, "dash_head", dash, {"millimetres_per_second": 0.0}, 0.25, body="body_ref")


async def _no_pulse(
    cell: RunningCell, name: str, begin: dict[str, Any], end: dict[str, Any], after: float, body: str = "*"
) -> Evidence:
    """Check that a pulse is given without the fault, and none `after` s of it."""
    await _arm(cell)
    control = await _fire(cell)
    async with poses(cell, body) as seen, injected(cell, name, begin, end):
        await asyncio.sleep(after)
        verdict = await refused(cell, "stimulation.fire", codes=PULSE_REFUSED)
        took_place = shown(seen, name, begin)
    code = verdict.reason.code if verdict.reason is not None else ""
    return Evidence(
        f"pulse refused: {code}",
        took_place={name: took_place},
        control_kind="without_fault",
        control={"a pulse before the fault": control},
    )


@fault("S10", how=f"{HOW}: 5 frames a second while the stimulator is armed")
async def slow_frames_at_pulse(lab: Lab) -> Evidence:
    """There is no pulse with frames that are too old."""
    async with lab.daemon(*ARMED) as cell:
        return await _no_pulse(cell, "tracker_rate", {"hertz": 5.0}, {"hertz": 0.0}, STALE)


@fault("S14", how="simulated muscle: pulses evoke no response during a threshold estimation", deadline=300.0)
async def no_response(lab: Lab) -> Evidence:
    """A threshold that no pulse reaches is refused."""
    async with lab.daemon(*ARMED, "procedure.stimulation.intervals.least=1.1") as cell:
        await to_placed(cell.client)
        await accept(cell.client, "stimulation.set_ceiling", percent=80.0, operator="simulated operator")
        await until(cell.client, lambda snapshot: snapshot.branches["alignment"] == "1")
        async with injected(cell, "no_mep"):
            pulses, result = await _estimate_threshold(cell)
        expect(bool(result.get("refusal")), f"A threshold came out of {pulses} pulses that evoked nothing: {result}.")
        evoked = await _muscle_response(cell)
    return Evidence(
        "threshold refused with its reason",
        took_place={"pulses that evoked nothing": pulses},
        control_kind="without_fault",
        control={"the muscle answers a pulse without the fault": evoked},
        details={"refusal": result["refusal"]},
    )


async def _estimate_threshold(cell: RunningCell) -> tuple[int, dict[str, Any]]:
    """Give pulses until the estimation ends; return their number and the last result."""
    await _begin_estimation(cell)
    pulses, result = 0, dict[str, Any]()
    while await state(cell.client, "threshold") == "hunting":
        result = await _pulse(cell)
        expect(not result["mep"]["present"], f"Pulse {pulses + 1} counts as answered: {result['mep']}.")
        pulses += 1
    return pulses, result


async def _muscle_response(cell: RunningCell) -> dict[str, Any]:
    """Return the muscle's response in another estimation without the fault.

    Raises:
        Unmet: It answers no pulse.
    """
    await _begin_estimation(cell)
    while await state(cell.client, "threshold") == "hunting":
        mep: dict[str, Any] = (await _pulse(cell))["mep"]
        if mep["present"]:
            return mep
    raise Unmet("No pulse evokes a response without the fault either.")


async def _begin_estimation(cell: RunningCell) -> None:
    begun = (await accept(cell.client, "threshold.begin")).result or {}
    await accept(cell.client, "stimulation.set_intensity", percent=begun.get("intensity", 50.0))
    if await state(cell.client, "stimulation") == "disarmed":
        await accept(cell.client, "stimulation.arm")


async def _pulse(cell: RunningCell) -> dict[str, Any]:
    await asyncio.sleep(1.2)
    return (await accept(cell.client, "threshold.pulse")).result or {}
