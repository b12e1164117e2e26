"""Lab Streaming Layer: markers; those of pulses are JSON.

python -m fuzz.lsl -max_total_time=60
"""

from __future__ import annotations

from fuzz.running import instrumented, run

with instrumented("pcmrs.devices.lsl"):
    from pcmrs.devices.lsl.markers import PulseMarker, read_pulse


def one(data: bytes) -> None:
    """Parse a marker."""
    marker = read_pulse(data)
    if marker is not None:
        assert isinstance(marker, PulseMarker)
        assert read_pulse(marker.text) == marker


if __name__ == "__main__":
    run(one)
