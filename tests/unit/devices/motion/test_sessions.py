"""Servo sessions one after the other: no set point and no end of an earlier one acts on a later one."""

from __future__ import annotations

import numpy as np
import pytest

from pcmrs.devices.motion.sessions import Sessions
from pcmrs.errors import DeviceError
from pcmrs.messages import JointSetpoint
from tests.unit.devices.spring import HOME, follower

STEP = 1 / 200


def setpoint(session: int, number: int, by: float = 0.01) -> JointSetpoint:
    return JointSetpoint(session=session, number=number, sent=0.0, positions=(HOME + by).tolist(), velocities=[0.0] * 7)


def test_only_newer_set_points_of_the_running_session_are_followed() -> None:
    arm, sessions = follower(STEP), Sessions()
    first = sessions.begin(arm).session
    sessions.end(first, arm)
    second = sessions.begin(arm).session
    for session, number in ((first, 9), (second, 2), (second, 2), (second, 1), (second + 1, 3)):
        sessions.take(setpoint(session, number), arm)
    assert sessions.dropped == 4
    assert sessions.servo is not None
    assert sessions.servo.number == 2
    sessions.take(setpoint(second, 3), None)
    assert (sessions.dropped, sessions.servo.number) == (5, 2), "the arm is not connected"


def test_the_end_of_an_earlier_session_does_not_end_a_later_one() -> None:
    arm, sessions = follower(STEP), Sessions()
    first = sessions.begin(arm).session
    sessions.end(first, arm)
    second = sessions.begin(arm).session
    with pytest.raises(DeviceError, match="is over") as error:
        sessions.end(first, arm)
    assert error.value.fields["session"] == first
    assert sessions.runs(arm)
    sessions.end(second, arm)
    with pytest.raises(DeviceError, match="is over"):
        sessions.end(second, arm)


def test_a_session_in_motion_is_braked_at_its_end() -> None:
    arm, sessions = follower(STEP), Sessions()
    session = sessions.begin(arm).session
    sessions.take(setpoint(session, 1, by=0.1), arm)
    speed = max(np.abs(arm.advance()[1]).max() for _ in range(15))
    sessions.end(session, arm)
    assert not sessions.runs(arm)
    while not arm.reference.ended:
        arm.advance()
    assert speed > 0.1
    assert arm.stopped is None, "it is the regular end"
    assert np.allclose(arm.reference.velocity, 0.0)


def test_no_motion_begins_beside_a_session_or_another_motion() -> None:
    arm, sessions = follower(STEP), Sessions()
    sessions.check_free(arm, busy=False)
    with pytest.raises(DeviceError, match="still moving"):
        sessions.check_free(arm, busy=True)
    session = sessions.begin(arm).session
    with pytest.raises(DeviceError, match="servo session runs"):
        sessions.check_free(arm, busy=False)
    arm.hold()
    sessions.check_free(arm, busy=False)
    sessions.take(setpoint(session, 1), arm)
    assert sessions.dropped == 1, "the session has ended by itself"
    with pytest.raises(DeviceError, match="is over"):
        sessions.end(session, arm)
