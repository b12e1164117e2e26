"""A label is present once it was seen for long enough, and until it was not seen for a while."""

from __future__ import annotations

from typing import Any

import pytest

from pcmrs.messages import SceneEvent
from pcmrs.scene.presence import MOST_OBJECTS, Presence
from pcmrs.scene.settings import SceneRuleSettings

RULE = SceneRuleSettings(label="hand", least_confidence=0.6, hysteresis=0.2, lasts=0.2, gone_after=0.5)


def seen(confidence: float = 0.9, **fields: Any) -> SceneEvent:
    values: dict[str, Any] = {
        "source": "camera",
        "label": "hand",
        "captured": 1.0,
        "sent": 1.0,
        "session": "s",
    } | fields
    return SceneEvent(confidence=confidence, **values)


def test_label_is_present_after_it_has_lasted() -> None:
    presence = Presence(RULE)
    begun = [presence.take(seen(track=number), now) for number, now in enumerate((0.0, 0.1, 0.2, 0.3))]
    assert begun == [False, False, True, False], "it begins once, whatever its track"
    assert presence.present


def test_a_pause_longer_than_the_limit_begins_again() -> None:
    presence = Presence(RULE)
    assert [presence.take(seen(), now) for now in (0.0, 0.1, 0.7, 0.8, 0.9)] == [False] * 4 + [True]


def test_single_frame_is_enough_if_nothing_must_last() -> None:
    presence = Presence(SceneRuleSettings(label="hand"))
    assert presence.take(seen(), 0.0)


@pytest.mark.parametrize(("confidence", "counts"), [(0.59, False), (0.6, True)])
def test_the_least_confidence_decides_at_first(confidence: float, counts: bool) -> None:
    presence = Presence(SceneRuleSettings(label="hand", least_confidence=0.6))
    assert presence.take(seen(confidence), 0.0) is counts


@pytest.mark.parametrize(("confidence", "stays"), [(0.39, False), (0.4, True)])
def test_less_confidence_keeps_a_label_present(confidence: float, stays: bool) -> None:
    presence = Presence(SceneRuleSettings(label="hand", least_confidence=0.6, hysteresis=0.2, gone_after=0.5))
    assert presence.take(seen(), 0.0)
    presence.take(seen(confidence), 0.4)
    presence.expire(0.8)
    assert presence.present is stays


def test_label_is_gone_only_after_the_limit() -> None:
    presence = Presence(SceneRuleSettings(label="hand", gone_after=0.5))
    presence.take(seen(), 0.0)
    presence.expire(0.5)
    assert presence.present
    presence.expire(0.51)
    assert not presence.present
    assert presence.take(seen(), 0.6), "it is a new one when it is seen again"


@pytest.mark.parametrize(
    "other", [{"track": 2}, {"region": "table"}, {"source": "second"}], ids=["track", "region", "source"]
)
def test_another_object_begins_while_the_label_is_present(other: dict[str, Any]) -> None:
    presence = Presence(SceneRuleSettings(label="hand", least_confidence=0.6, hysteresis=0.2, gone_after=0.5))
    assert presence.take(seen(track=1), 0.0)
    assert not presence.take(seen(track=1), 0.1)
    assert not presence.take(seen(0.5, **({"track": 1} | other)), 0.2), "the hysteresis is for what was there"
    assert presence.take(seen(**({"track": 1} | other)), 0.3)
    assert not presence.take(seen(track=1), 0.4)
    assert not presence.take(seen(**({"track": 1} | other)), 0.5)


def test_another_object_must_last_as_well() -> None:
    presence = Presence(RULE)
    assert [presence.take(seen(track=1), now) for now in (0.0, 0.2)] == [False, True]
    assert [presence.take(seen(track=2), now) for now in (0.3, 0.4, 0.6)] == [False, False, True]


def test_object_that_was_gone_is_new_beside_one_that_stays() -> None:
    presence = Presence(SceneRuleSettings(label="hand", gone_after=0.5))
    begun = [presence.take(seen(track=number), now) for now, number in ((0.0, 2), (0.3, 1), (0.6, 1), (0.7, 2))]
    assert begun == [True, True, False, True]


def test_objects_beyond_the_limit_count_as_one() -> None:
    presence = Presence(SceneRuleSettings(label="hand", gone_after=0.5))
    assert all(presence.take(seen(track=number), 0.0) for number in range(MOST_OBJECTS))
    assert presence.take(seen(track=100), 0.1)
    assert not any(presence.take(seen(track=number), 0.1) for number in range(200, 10_000))
