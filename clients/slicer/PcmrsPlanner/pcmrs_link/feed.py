"""What OpenIGTLink tells besides: the state of all branches, and poses of tool and body; read only, never waits.

The string protocol tells a state only with a verdict. Messages of header version 1 are read, TRANSFORM and STRING of
them; layouts from the OpenIGTLink protocol, version 2.
"""

from __future__ import annotations

import errno
import json
import socket
import struct
import time
from collections.abc import Callable
from dataclasses import dataclass, field

from .link import Seen
from .messages import MessageError
from .poses import PoseError, pose_of_matrix

PORT = 18944
RETRY_AFTER = 1.0
HEADER = struct.Struct(">H12s20sQQQ")
MATRIX = struct.Struct(">12f")
TEXT = struct.Struct(">HH")
MAX_BODY = 1 << 20
CHUNK = 1 << 16
MAX_CHUNKS = 64
"""Read in one tick at most, so that a flood does not freeze the program."""

_CONNECTING = (errno.EINPROGRESS, errno.EALREADY, errno.EWOULDBLOCK)


@dataclass(frozen=True)
class CellState:
    """State of all branches: see ``PcmrsState`` in the daemon's documentation."""

    sequence: int
    branches: dict[str, str]
    running: list[str]
    latched: bool
    plan: str | None
    registration: str | None
    prompt: str = ""


@dataclass
class Feed:
    """A connection to the daemon's OpenIGTLink server that is made again when it breaks.

    Args:
        host: The daemon's, IPv4.
        port: Of ``gateway.openigtlink``.
        clock: Seconds that only grow.

    Attributes:
        state: Last received; None before, and while not connected.
        seen: Newest of each TRANSFORM by name, such as ``CoilToImage``.
        problem: Why it is not connected; None while it is.
    """

    host: str = "127.0.0.1"
    port: int = PORT
    clock: Callable[[], float] = time.monotonic
    state: CellState | None = field(default=None, init=False)
    seen: dict[str, Seen] = field(default_factory=dict, init=False)
    problem: str | None = field(default="not connected yet", init=False)

    def __post_init__(self) -> None:
        self._socket: socket.socket | None = None
        self._buffer = bytearray()
        self._try_at = self.clock()

    def close(self) -> None:
        """End the connection."""
        if self._socket is not None:
            self._socket.close()
        self._socket = None

    def age(self, name: str) -> float | None:
        """Seconds since a transform arrived; None if none has."""
        seen = self.seen.get(name)
        return None if seen is None else self.clock() - seen.at

    def tick(self) -> None:
        """Connect if there is no connection, and take everything that has arrived."""
        try:
            if self._socket is None:
                self._connect()
            elif self._connected(self._socket):
                self._read(self._socket)
        except (OSError, MessageError) as error:
            self._lose(str(error))

    def _connect(self) -> None:
        if self.clock() < self._try_at:
            return
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        self._socket.setblocking(False)
        self._try_at = self.clock() + RETRY_AFTER
        code = self._socket.connect_ex((self.host, self.port))
        if code not in (0, *_CONNECTING):
            raise OSError(code, "cannot connect")

    def _connected(self, connection: socket.socket) -> bool:
        code = connection.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)
        if code:
            raise OSError(code, "cannot connect")
        try:
            connection.getpeername()
        except OSError:
            return False
        self.problem = None
        return True

    def _lose(self, problem: str) -> None:
        """Forget the received state, which other clients may change without a connection."""
        self.close()
        self._buffer.clear()
        self.state, self.problem = None, problem
        self._try_at = self.clock() + RETRY_AFTER

    def _read(self, connection: socket.socket) -> None:
        for _ in range(MAX_CHUNKS):
            try:
                data = connection.recv(CHUNK)
            except BlockingIOError:
                return
            if not data:
                raise OSError("the daemon has closed the connection")
            self._buffer += data
            self._take_messages()

    def _take_messages(self) -> None:
        while len(self._buffer) >= HEADER.size:
            version, kind, name, _, size, crc = HEADER.unpack_from(self._buffer)
            if version != 1 or size > MAX_BODY:
                raise MessageError("the message does not have an OpenIGTLink header of version 1")
            if len(self._buffer) < HEADER.size + size:
                return
            body = bytes(self._buffer[HEADER.size : HEADER.size + size])
            del self._buffer[: HEADER.size + size]
            self._take(_text(kind), _text(name), body, crc)

    def _take(self, kind: str, name: str, body: bytes, crc: int) -> None:
        if kind == "TRANSFORM" and len(body) == MATRIX.size:
            self._check(body, crc)
            self._take_transform(name, MATRIX.unpack(body))
        elif kind == "STRING" and name == "PcmrsState":
            self._check(body, crc)
            self.state = parse_state(body[TEXT.size :])

    def _take_transform(self, name: str, columns: tuple[float, ...]) -> None:
        rows = [[columns[3 * column + row] for column in range(4)] for row in range(3)]
        try:
            self.seen[name] = Seen(pose_of_matrix(rows), self.clock())
        except PoseError as error:
            raise MessageError(f"{name}: {error}") from None

    def _check(self, body: bytes, crc: int) -> None:
        if crc64(body) != crc:
            raise MessageError("a message is damaged")


def parse_state(text: bytes) -> CellState:
    """Read the state in ``PcmrsState``.

    Raises:
        MessageError: It is not a state.
    """
    try:
        told = json.loads(text.decode("utf-8"))
        return CellState(
            sequence=int(told["sequence"]),
            branches={str(branch): str(state) for branch, state in told["branches"].items()},
            running=[str(each) for each in told["running"]],
            latched=bool(told["latched"]),
            plan=told["plan"],
            registration=told["registration"],
            prompt=str(told.get("prompt", "")),
        )
    except (ValueError, KeyError, TypeError, AttributeError):
        raise MessageError(f"{text[:60]!r} is no state.") from None


def crc64(data: bytes) -> int:
    """CRC-64 of ECMA-182, as OpenIGTLink has it."""
    crc = 0
    for byte in data:
        crc = (crc << 8 & 0xFFFFFFFFFFFFFFFF) ^ _CRC_TABLE[crc >> 56 ^ byte]
    return crc


def _table_entry(byte: int) -> int:
    crc = byte << 56
    for _ in range(8):
        crc = (crc << 1 ^ (0x42F0E1EBA9EA3693 if crc >> 63 else 0)) & 0xFFFFFFFFFFFFFFFF
    return crc


_CRC_TABLE = [_table_entry(byte) for byte in range(256)]


def _text(padded: bytes) -> str:
    return padded.split(b"\0")[0].decode("ascii", "replace")
