"""The golden journals: recorded by `tests/system/lab/record_golden.py`, replayed in every run of the tests."""

from __future__ import annotations

from pathlib import Path

GOLDEN = Path(__file__).parent / "golden"
WORKFLOWS = ("ratms", "femoroplasty", "grid_mapping", "ratms_threshold")
