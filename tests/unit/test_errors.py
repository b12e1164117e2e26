"""The error tree: codes that programs may match on, and values beside the text."""

from __future__ import annotations

import inspect
import re
from collections import Counter

import pytest

from pcmrs import errors
from pcmrs.errors import DeviceError, GeometryError, PcmrsError, RefusalError

TREE = [each for each in vars(errors).values() if inspect.isclass(each) and issubclass(each, PcmrsError)]


def test_every_error_has_its_own_stable_code() -> None:
    """A code that two errors share, or that a child inherits, says less than the class."""
    assert [code for code, count in Counter(each.code for each in TREE).items() if count > 1] == []
    assert [each.code for each in TREE if not re.fullmatch(r"[a-z][a-z_]+", each.code)] == []
    assert [each.__name__ for each in TREE if not each.__name__.endswith("Error")] == []


@pytest.mark.parametrize("kind", [each for each in TREE if each is not RefusalError])
def test_error_carries_its_text_and_values(kind: type[PcmrsError]) -> None:
    error = kind("31 N, limit 30 N.", force=31.0, limit=30.0)
    assert (str(error), error.text, error.fields) == ("31 N, limit 30 N.",) * 2 + ({"force": 31.0, "limit": 30.0},)


def test_a_refusal_has_the_code_of_its_reason_beside_its_own() -> None:
    error = RefusalError("residual_too_large", "8.2 mm, limit 4.0 mm.", residual=8.2)
    assert (error.code, error.refusal_code, error.fields) == ("refused", "residual_too_large", {"residual": 8.2})


def test_who_handles_the_base_handles_its_kinds() -> None:
    """A device that refuses has failed; points that are mirrored are bad geometry."""
    assert issubclass(errors.DeviceRefusedError, DeviceError)
    assert issubclass(errors.MotionInterruptedError, DeviceError)
    assert {each for each in TREE if issubclass(each, GeometryError)} >= {
        errors.MirroredPointsError,
        errors.UnreachableError,
        errors.DegeneratePointsError,
    }
    assert not issubclass(errors.UnknownOutcomeError, DeviceError), "it is unknown, and not failed"
