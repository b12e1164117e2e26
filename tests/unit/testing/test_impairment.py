"""An impaired link loses, doubles and delays as it says, by its seed."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.testing.impairment import NetworkImpairment
from tests.support.trials import examples


@examples(15)
@given(seed=st.integers(0, 1000), loss=st.floats(0.0, 1.0), doubled=st.floats(0.0, 1.0))
def test_counted_losses_and_doublings_are_those_that_happen(seed: int, loss: float, doubled: float) -> None:
    weather = NetworkImpairment(seed=seed, loss=loss, doubled=doubled)
    arrived = sum(len(weather.delays(0.0)) for _ in range(200))
    assert arrived == 200 - weather.counted["lost"] + weather.counted["doubled"]
    assert abs(weather.counted["lost"] - 200 * loss) <= 5 * (200 * loss * (1 - loss)) ** 0.5 + 1


@given(seed=st.integers(0, 1000))
def test_a_seed_always_gives_the_same_weather(seed: int) -> None:
    first, second = (NetworkImpairment(seed=seed, loss=0.3, doubled=0.3, jitter=0.2) for _ in range(2))
    assert [first.delays(0.0) for _ in range(50)] == [second.delays(0.0) for _ in range(50)]


def test_message_arriving_before_an_earlier_one_has_overtaken_it() -> None:
    weather = NetworkImpairment(delay=0.5)
    assert weather.wait(0.0) == 0.5
    weather.delay = 0.1
    assert weather.wait(0.2) == 0.1
    assert weather.counted["overtaken"] == 1
    weather.wait(0.5)
    assert weather.counted["overtaken"] == 1, "it arrives after both"


def test_jitter_is_added_to_the_delay_and_bounded() -> None:
    weather = NetworkImpairment(seed=3, delay=0.5, jitter=0.2)
    delays = [weather.wait(float(number)) for number in range(100)]
    assert 0.5 <= min(delays) < max(delays) <= 0.7


@pytest.mark.parametrize("direction", ["towards", "back"])
def test_only_the_cut_direction_is_cut(direction: str) -> None:
    weather = NetworkImpairment()
    setattr(weather, direction, False)
    assert [weather.passes(each) for each in ("towards", "back")] == [direction != "towards", direction != "back"]


def test_a_rate_limits_until_it_is_removed() -> None:
    weather = NetworkImpairment(rate=1000.0)
    assert weather.narrow == 1000.0
    weather.rate = None
    assert weather.narrow is None
