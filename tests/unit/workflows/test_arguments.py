"""Arguments that operations share: names that are safe on a record, and coordinates that are metres."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from pcmrs.errors import RefusalError
from pcmrs.workflows._arguments import MAX_COORDINATE, PersonName, Retreat, check_metres


@pytest.mark.parametrize("name", ["Dr Hand", "王小明", "O'Neill-Smith, A.", "x" * 100])
def test_names_of_people_are_accepted_as_written(name: str) -> None:
    assert msgspec.convert(name, PersonName) == name


@pytest.mark.parametrize("name", ["", " ", "--", "A\nB", "A\tB", "A\x1b[2J", "A\u202eB", "A\u2028B", "x" * 101, "A\n"])
def test_a_name_that_could_forge_a_record_is_refused(name: str) -> None:
    with pytest.raises(msgspec.ValidationError):
        msgspec.convert(name, PersonName)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_coordinates_in_millimetres_are_refused_with_the_limit(sign: float) -> None:
    check_metres(np.full((2, 3), sign * MAX_COORDINATE))
    points = np.zeros((4, 3))
    points[2, 1] = sign * 70.0
    with pytest.raises(RefusalError, match=r"A coordinate is 70 m; the limit is 1 m\. Were these milli") as refused:
        check_metres(points)
    assert refused.value.refusal_code == "wrong_unit"
    assert refused.value.fields == {"value": 70.0, "limit": MAX_COORDINATE}


def test_a_retreat_is_not_confirmed_unless_it_is_said() -> None:
    assert not msgspec.convert({}, Retreat).confirm
    for arguments in ({"confirm": "yes"}, {"confirm": 1}, {"confirmed": True}):
        with pytest.raises(msgspec.ValidationError):
            msgspec.convert(arguments, Retreat)
