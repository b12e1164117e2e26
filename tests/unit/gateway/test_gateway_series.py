from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.errors import RefusalError
from pcmrs.gateway.commands import PlanKind
from pcmrs.gateway.handlers import PAIR_WINDOW, LandmarkSeries, PlanLock, PosePair


@given(st.integers(1, 12), st.lists(st.integers(0, 13), max_size=16))
def test_a_series_is_complete_exactly_when_every_index_came_once(count: int, indices: list[int]) -> None:
    series = LandmarkSeries()
    series.announce(count)
    try:
        for index in indices:
            series.add(index, [float(index), 0.0, 0.0])
        landmarks = series.finish()
    except RefusalError:
        assert sorted(indices) != list(range(count))
        with pytest.raises(RefusalError, match="announce"):
            series.add(0, [0.0, 0.0, 0.0])
    else:
        assert sorted(indices) == list(range(count))
        assert landmarks == [{"name": f"p{i}", "position": [float(i), 0.0, 0.0]} for i in range(count)]


@given(st.integers(1, 6).flatmap(lambda count: st.permutations(range(count))), st.integers(0, 8), st.integers(0, 6))
def test_one_landmark_too_many_drops_the_series(order: list[int], extra: int, place: int) -> None:
    """Also the last one, of a series that was complete without it."""
    series = LandmarkSeries()

    def send(indices: list[int]) -> None:
        series.announce(len(order))
        for index in indices:
            series.add(index, [0.0, 0.0, 0.0])

    with pytest.raises(RefusalError) as refusal:
        send([*order[:place], extra, *order[place:]])
    assert refusal.value.refusal_code == "bad_series"
    fault = "came twice" if extra < len(order) else f"lies outside the {len(order)} announced"
    assert f"Landmark {extra} {fault};" in refusal.value.text
    with pytest.raises(RefusalError, match="announce"):
        series.finish()


def test_a_new_announcement_drops_the_points_before_it() -> None:
    series = LandmarkSeries()
    series.announce(1)
    series.add(0, [1.0, 1.0, 1.0])
    series.announce(1)
    with pytest.raises(RefusalError) as refusal:
        series.finish()
    assert refusal.value.refusal_code == "incomplete_series"


@pytest.mark.parametrize(("age", "fits"), [(PAIR_WINDOW, True), (PAIR_WINDOW + 0.001, False)])
def test_a_pair_closes_within_its_window(age: float, fits: bool) -> None:
    pair = PosePair()
    pair.rotate([0.0, 0.0, 0.0, 1.0], 0.0)
    if fits:
        assert pair.translate([1.0, 2.0, 3.0], age)["quat_xyzw"] == [0.0, 0.0, 0.0, 1.0]
    else:
        with pytest.raises(RefusalError, match="limit is 1 s"):
            pair.translate([1.0, 2.0, 3.0], age)
    with pytest.raises(RefusalError, match="without a rotation"):
        pair.translate([1.0, 2.0, 3.0], age)


def test_a_second_rotation_replaces_the_first() -> None:
    pair = PosePair()
    pair.rotate([1.0, 0.0, 0.0, 0.0], 0.0)
    pair.rotate([0.0, 1.0, 0.0, 0.0], 0.9)
    assert pair.translate([0.0, 0.0, 0.0], 1.8)["quat_xyzw"] == [0.0, 1.0, 0.0, 0.0]


@given(st.lists(st.tuples(st.sampled_from(list(PlanKind)), st.booleans())))
def test_lock_holds_while_a_newest_plan_is_not_accepted(plans: list[tuple[PlanKind, bool]]) -> None:
    """It holds if the newest plan of any kind is not accepted."""
    lock = PlanLock()
    for kind, accepted in plans:
        attempt = lock.attempt(kind)
        if accepted:
            lock.accept(kind, attempt)
    newest = dict(plans)
    assert lock.held == (not all(newest.values()))


def test_acceptance_of_an_older_plan_does_not_open_the_lock() -> None:
    lock = PlanLock()
    older = lock.attempt(PlanKind.POSE)
    lock.attempt(PlanKind.POSE)
    lock.accept(PlanKind.POSE, older)
    assert lock.held
