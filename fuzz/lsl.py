"""Lab Streaming Layer: markers, of which those of pulses are JSON.

python -m fuzz.lsl -max_total_time=60
"""

from __future__ import annotations

import atheris

from fuzz.running import run

with atheris.instrument_imports(include=["pcmrs.devices.lsl"]):
    from pcmrs.devices.lsl.markers import PulseMarker, read_pulse


def one(data: bytes) -> None:
    marker = read_pulse(data)
    if marker is not None:
        assert isinstance(marker, PulseMarker)
        assert read_pulse(marker.text) == marker


if __name__ == "__main__":
    run(one, b'{"pulse":3,"intensity":55.0}', b'{"pulse":3}', b"stop", b"pulse:3")
