"""Keys and names of topics: what ROS does not allow in a name is replaced, and the bridge finds its namespace."""

from __future__ import annotations

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.errors import PayloadError
from pcmrs.ros2.topics import PREFIX, TOPICS, Topic, namespace, pose_topic, tracker_key

ALLOWED = re.compile(r"[A-Za-z0-9_/]+")


@given(st.text(min_size=1))
def test_every_body_has_a_topic_that_ros_allows(body: str) -> None:
    topic = pose_topic(body)
    assert ALLOWED.fullmatch(topic.name)
    assert topic.key == f"ros2/pose/{topic.name.removeprefix('pose/')}"
    assert topic.name.count("/") == 1, "a body cannot name another topic"


def test_a_name_that_ros_allows_is_kept() -> None:
    assert pose_topic("body_ref").name == "pose/body_ref"
    assert pose_topic("coil-2").name == "pose/coil_2"
    assert tracker_key("coil") == "ros2/tracker/coil"


def test_a_key_is_the_namespace_of_the_bridge_and_the_topic() -> None:
    """The bridge turns ``<namespace>/<topic>`` into ``/<topic>``."""
    assert namespace("lab", "cell1") == f"/pcmrs/lab/cell1/{PREFIX}"
    for topic in TOPICS:
        assert f"/pcmrs/lab/cell1/{topic.key}" == f"{namespace('lab', 'cell1')}/{topic.name}"


@pytest.mark.parametrize("name", ["", "a/b", "*", "a b$"])
def test_a_cell_that_cannot_be_in_a_key_has_no_namespace(name: str) -> None:
    for site, cell in ((name, "cell1"), ("lab", name)):
        with pytest.raises(PayloadError):
            namespace(site, cell)


def test_a_token_has_no_slash_in_its_key_and_type() -> None:
    token = Topic("pose/coil", "geometry_msgs/msg/PoseStamped").token("id", "pcmrs/lab/cell1")
    assert token.split("/")[:4] == ["@", "id", "@ros2_lv", "MP"]
    key, kind, quality = token.split("/")[4:]
    assert key.replace("§", "/") == "pcmrs/lab/cell1/ros2/pose/coil"
    assert kind.replace("§", "/") == "geometry_msgs/msg/PoseStamped"
    assert re.fullmatch(r":1:[01]:0,\d+", quality)
