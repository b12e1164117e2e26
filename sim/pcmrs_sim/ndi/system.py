"""The virtual tracker as a program sees it: its port handles, its modes, and a reply to each command.

Commands, modes and error numbers are those of NDI's API guide.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field

from pcmrs.messages import BodyPose
from pcmrs_sim.ndi.protocol import INVALID, PARAMETERS, CommandError, NdiCommand, parse, reply
from pcmrs_sim.ndi.replies import ENABLED, INITIALIZED, OCCUPIED, HandleReport, float_reply, text_reply
from pcmrs_sim.tracker_faults import BODIES

INVALID_PORT, BAD_MODE, NO_TOOL, NOT_INITIALIZED_PORT = 0x08, 0x0C, 0x0D, 0x0E
NOT_INITIALIZED, CANNOT_INITIALIZE_PORT, CANNOT_INITIALIZE = 0x10, 0x13, 0x15
OUT_OF_RANGE, NO_HANDLE, HANDLES_FULL = 0x23, 0x2B, 0x2D
"""Numbers of the errors of commands that cannot be executed."""

MOST_HANDLES = 6
"""Number of port handles, as of a Vicra."""
SROM_SIZE = 1024
"""Size of a tool definition, bytes."""

COUNTS = "123456789"
"""Numbers of beeps that one command may ask for."""
MOST_BEEPS = 100
"""Number of the last requests for beeps that are kept."""

VERSION = """Polaris Vega Control Firmware
Freeze Tag: Polaris Vega Rev 007.000.012 (virtual)
Freeze Date:01/01/25
(C) PCMRS: a simulated tracker
"""


@dataclass
class Handle:
    """A port handle with its tool definition.

    Attributes:
        srom: The tool definition, bytes.
        written: A part of the tool definition was written. A wireless tool without one does not occupy its handle.
        initialized: It was initialized.
        enabled: It was enabled: its tool is tracked.
        body: Body that it tracks; None until it is initialized, or if no body is left.
    """

    srom: bytearray = field(default_factory=lambda: bytearray(SROM_SIZE))
    written: bool = False
    initialized: bool = False
    enabled: bool = False
    body: str | None = None

    @property
    def status(self) -> int:
        """Bits of the port's status that do not depend on a frame."""
        return OCCUPIED * self.written | INITIALIZED * self.initialized | ENABLED * self.enabled


class NdiSystem:
    """System that replies to commands, independent of any link.

    A tool definition that names a body tracks this body; those that the driver's `placeholder` makes do. Any other
    definition tracks the next body that no handle tracks yet.

    Args:
        newest: Returns the newest published frame of the simulated tracker; empty before the first.
        plugged: Returns true while the position sensor is plugged in.
        wrong_tools: Returns the bodies that carry another tool than the one that is defined for them.

    Attributes:
        beeps: Number of beeps of each of the last requests for them, in order.
    """

    def __init__(
        self,
        newest: Callable[[], Sequence[BodyPose]],
        plugged: Callable[[], bool],
        wrong_tools: Callable[[], Collection[str]] = tuple,
    ) -> None:
        self._newest = newest
        self._plugged = plugged
        self._wrong_tools = wrong_tools
        self._handles: dict[int, Handle] = {}
        self._initialized = self._tracking = False
        self.beeps: deque[int] = deque(maxlen=MOST_BEEPS)
        self._anytime = {"RESET": self._reset, "VER": self._version, "COMM": self._okay, "BEEP": self._beep}
        self._setting_up = {
            "INIT": self._init,
            "PHRQ": self._request,
            "PHSR": self._search,
            "PHINF": self._information,
            "PHF": self._free,
            "PVWR": self._write,
            "PINIT": self._initialize,
            "PENA": self._enable,
            "PDIS": self._disable,
            "TSTART": self._start,
        }
        self._while_tracking = {"TSTOP": self._stop, "TX": self._text, "BX": self._floats}

    def answer(self, line: bytes) -> bytes:
        """Return the reply to a command without its carriage return. Each command has one reply."""
        try:
            return self._perform(parse(line))
        except CommandError as error:
            return reply(str(error))

    def _perform(self, request: NdiCommand) -> bytes:
        if request.name in self._anytime:
            return self._anytime[request.name](request.parameters)
        if request.name in self._setting_up:
            self._check_mode(request.name == "INIT", tracking=False)
            return self._setting_up[request.name](request.parameters)
        if request.name in self._while_tracking:
            self._check_mode(False, tracking=True)
            return self._while_tracking[request.name](request.parameters)
        raise CommandError(INVALID)

    def _check_mode(self, is_init: bool, tracking: bool) -> None:
        if not self._initialized and not is_init:
            raise CommandError(NOT_INITIALIZED)
        if self._tracking != tracking:
            raise CommandError(BAD_MODE)

    def _okay(self, _: str) -> bytes:
        return reply("OKAY")

    def _reset(self, _: str) -> bytes:
        self._handles.clear()
        self._initialized = self._tracking = False
        return reply("RESET")

    def _version(self, _: str) -> bytes:
        return reply(VERSION)

    def _beep(self, count: str) -> bytes:
        if len(count) != 1 or count not in COUNTS:
            raise CommandError(INVALID)
        self.beeps.append(int(count))
        return reply("1")

    def _init(self, _: str) -> bytes:
        if not self._plugged():
            raise CommandError(CANNOT_INITIALIZE)
        self._handles.clear()  # those of an earlier client that did not free them
        self._initialized = True
        return reply("OKAY")

    def _request(self, _: str) -> bytes:
        free = [number for number in range(1, MOST_HANDLES + 1) if number not in self._handles]
        if not free:
            raise CommandError(HANDLES_FULL)
        self._handles[free[0]] = Handle()
        return reply(f"{free[0]:02X}")

    def _search(self, parameters: str) -> bytes:
        wanted: dict[str, Callable[[Handle], bool]] = {
            "": lambda _: True,
            "00": lambda _: True,
            "01": lambda handle: not handle.written,  # to be freed: no tool occupies it
            "02": lambda handle: handle.written and not handle.initialized,
            "03": lambda handle: handle.initialized and not handle.enabled,
            "04": lambda handle: handle.enabled,
        }
        if parameters not in wanted:
            raise CommandError(OUT_OF_RANGE)
        found = {number: each for number, each in self._handles.items() if wanted[parameters](each)}
        return reply(f"{len(found):02X}" + "".join(f"{number:02X}{each.status:03X}" for number, each in found.items()))

    def _information(self, parameters: str) -> bytes:
        number, handle = self._handle(parameters[:2])
        if parameters[2:] not in ("", "0001"):
            raise CommandError(OUT_OF_RANGE)
        return reply(f"02000000{'PCMRS':12}001{number:08X}{handle.status:02X}")

    def _free(self, parameters: str) -> bytes:
        number, _ = self._handle(parameters)
        del self._handles[number]
        return reply("OKAY")

    def _write(self, parameters: str) -> bytes:
        _, handle = self._handle(parameters[:2])
        start, data = _hexadecimal(parameters[2:6], 4), parameters[6:]
        if len(data) != 128:
            raise CommandError(PARAMETERS)
        if start > SROM_SIZE - 64:
            raise CommandError(OUT_OF_RANGE)
        try:
            handle.srom[start : start + 64] = bytes.fromhex(data)
        except ValueError:
            raise CommandError(PARAMETERS) from None
        handle.written = True
        return reply("OKAY")

    def _initialize(self, parameters: str) -> bytes:
        _, handle = self._handle(parameters)
        if not handle.written:
            raise CommandError(NO_TOOL)
        shown = {each.body for each in self._handles.values()}
        named = [body for body in BODIES if f"PCMRS:{body}\0".encode() in handle.srom]
        body = next(iter(named or [body for body in BODIES if body not in shown]), None)
        if body in self._wrong_tools():
            raise CommandError(CANNOT_INITIALIZE_PORT)
        handle.initialized, handle.body = True, body
        return reply("OKAY")

    def _enable(self, parameters: str) -> bytes:
        _, handle = self._handle(parameters[:2])
        if parameters[2:] not in ("S", "D", "B"):
            raise CommandError(PARAMETERS)
        if not handle.initialized:
            raise CommandError(NOT_INITIALIZED_PORT)
        handle.enabled = True
        return reply("OKAY")

    def _disable(self, parameters: str) -> bytes:
        _, handle = self._handle(parameters)
        handle.enabled = False
        return reply("OKAY")

    def _start(self, _: str) -> bytes:
        self._check_plugged()
        self._tracking = True
        return reply("OKAY")

    def _stop(self, _: str) -> bytes:
        self._tracking = False
        return reply("OKAY")

    def _text(self, parameters: str) -> bytes:
        return text_reply(self._reports(parameters))

    def _floats(self, parameters: str) -> bytes:
        return float_reply(self._reports(parameters))

    def _reports(self, options: str) -> list[HandleReport]:
        if options not in ("", "0001", "0801"):
            raise CommandError(OUT_OF_RANGE)
        self._check_plugged()
        poses = {pose.body: pose for pose in self._newest()}
        number = max((pose.frame_number for pose in poses.values()), default=0)
        unseen = BodyPose(body="", frame_number=number, captured=0.0, sent=0.0, valid=False)
        return [
            HandleReport(number, each.status, poses.get(each.body or "", unseen) if each.enabled else None)
            for number, each in self._handles.items()
        ]

    def _check_plugged(self) -> None:
        if not self._plugged():
            self._initialized = self._tracking = False
            raise CommandError(NOT_INITIALIZED)

    def _handle(self, text: str) -> tuple[int, Handle]:
        number = _hexadecimal(text, 2)
        if number not in self._handles:
            raise CommandError(NO_HANDLE)
        return number, self._handles[number]


def _hexadecimal(text: str, digits: int) -> int:
    if len(text) != digits or not all(each in "0123456789abcdefABCDEF" for each in text):
        raise CommandError(PARAMETERS)
    return int(text, 16)
