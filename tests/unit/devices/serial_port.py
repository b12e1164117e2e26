"""A serial port whose lines can be seen, and which can fail, for tests."""

from __future__ import annotations


class Port:
    """Stands in for a serial port whose lines can be seen, and which can fail; a pty has no lines."""

    is_open = True
    port = "/dev/pretended"

    def __init__(self) -> None:
        self.seen: list[tuple[str, object]] = []
        self.broken = False

    def __setattr__(self, name: str, value: object) -> None:
        if name in ("dtr", "rts"):
            self.seen.append((name, value))
        object.__setattr__(self, name, value)

    def write(self, data: bytes) -> None:
        if self.broken:
            raise OSError("Input/output error")

    def close(self) -> None:
        self.is_open = False
