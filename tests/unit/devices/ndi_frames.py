"""Frames of a tracker and reports of the reader process, for tests."""

from __future__ import annotations

from hypothesis import strategies as st

from pcmrs.devices.ndi.wire import Failed, NdiFrame, ToolFrame, TrackerReady

words = st.integers(0, 2**32 - 1)

numbers = st.tuples(*[st.floats()] * 8)

tools = st.builds(ToolFrame, st.sampled_from(["coil", "pointer"]), words, words, st.none() | numbers)

frames = st.builds(NdiFrame, st.floats(0.0, 1e6), words, st.lists(tools, max_size=4))

reports = st.one_of(frames, st.builds(TrackerReady, st.text(), st.booleans()), st.builds(Failed, st.text()))
