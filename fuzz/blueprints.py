"""Blueprints: each input is a verified workflow, or is refused with its errors.

python -m fuzz.blueprints -max_total_time=60
"""

from __future__ import annotations

from fuzz.running import instrumented, run

with instrumented("pcmrs.fsm"):
    from pcmrs.errors import PcmrsError
    from pcmrs.fsm import Blueprint, parse_blueprint


def one(data: bytes) -> None:
    """Parse a blueprint."""
    try:
        blueprint = parse_blueprint(data)
    except PcmrsError:
        return
    assert isinstance(blueprint, Blueprint)


if __name__ == "__main__":
    run(one)
