"""Which keys are recorded or played: none twice, and no other."""

from __future__ import annotations

from collections.abc import Sequence

import pytest

from pcmrs.errors import ConfigurationError
from pcmrs.recording.topics import TOPICS, TopicFilter, check_topics


@pytest.mark.parametrize(
    ("topics", "words"),
    [
        ((), "No topics are given"),
        (("state/**", "state/pose/*"), r"state/\*\* and state/pose/\* overlap"),
        (("state/fsm", "state/fsm"), "overlap"),
        (("state//x",), "'state//x' is not a key expression"),
        (("",), "is not a key expression"),
    ],
)
def test_no_or_overlapping_topics_are_refused(topics: Sequence[str], words: str) -> None:
    with pytest.raises(ConfigurationError, match=words):
        check_topics(topics)


def test_topics_of_the_default_do_not_overlap() -> None:
    """A message on a key that two of them share would be recorded twice."""
    check_topics(TOPICS)


@pytest.mark.parametrize(
    ("topics", "included", "excluded"),
    [
        ((), ["state/fsm", "cmd/robot/connect"], []),
        (("state/pose/*",), ["state/pose/coil"], ["state/pose", "state/pose/coil/x", "state/fsm"]),
        (("cmd/**", "stop/*"), ["cmd", "cmd/a/b/c", "stop/x"], ["stop", "state/fsm"]),
        (TOPICS, ["dev/robot/state", "state/joints"], ["heart/daemon", "state/video/left", "dev/robot/heart"]),
    ],
)
def test_a_key_passes_if_an_expression_includes_it(
    topics: Sequence[str], included: list[str], excluded: list[str]
) -> None:
    wanted = TopicFilter(topics)
    for _ in range(2):  # the second time from memory
        assert all(wanted(key) for key in included)
        assert not any(wanted(key) for key in excluded)


def test_a_filter_needs_key_expressions() -> None:
    with pytest.raises(ConfigurationError, match="is not a key expression"):
        TopicFilter(["state/fsm", "a//b"])
