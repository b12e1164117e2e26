"""Playback of a recorded session: everything that was known at any moment of it. It publishes nothing."""

from __future__ import annotations

from bisect import bisect_right
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

from pcmrs.bus.codec import convert_event, unpack
from pcmrs.console._cell_view_model import EPOCHS, EVENTS, NOTHING, CellViewModel
from pcmrs.errors import FileFormatError, PcmrsError
from pcmrs.fsm import Blueprint
from pcmrs.messages import BodyPose, DeviceEvent, Epoch, JointState, Snapshot, Target, Verdict
from pcmrs.messages.health import Health
from pcmrs.messages.setup import ProcedureDataView, Setup
from pcmrs.recording.reader import RecordingReader, check_format

RATE_HZ = 10.0
"""Rate of the stored joints and poses: faster than the eye, and an hour of them fits into memory."""
THINNED = ("state/joints", "state/pose/")
WHOLE = ("state/fsm", "state/event", "state/target", "state/data", "state/epoch", "state/health")
_SECOND = 1e9
T = TypeVar("T")


@dataclass
class MessageTrack:
    """Messages of one key, in order: times, s since the beginning, and payloads."""

    times: list[float] = field(default_factory=list)
    payloads: list[bytes] = field(default_factory=list)

    def add(self, at: float, payload: bytes) -> None:
        """Add a message; the recorder's times never decrease.

        Args:
            at: Time, s since the beginning.
            payload: Payload of the message.
        """
        self.times.append(at)
        self.payloads.append(payload)

    def until(self, at: float) -> int:
        """Return the number of messages up to a moment."""
        return bisect_right(self.times, at)


@dataclass(frozen=True, slots=True)
class LoadedRecording:
    """Content of a recording.

    Attributes:
        started_at: Start of the recording, Unix s.
        duration: Duration, s.
        tracks: Key to its messages.
        damage: Description of the unreadable part; empty if there is none.
    """

    started_at: float
    duration: float
    tracks: dict[str, MessageTrack]
    damage: str


def load_recording(files: Sequence[Path], progress: Callable[[float], None]) -> LoadedRecording:
    """Read a recording, thinned. It takes long, so do not call it in an event loop.

    Args:
        files: Files of one recording, oldest first.
        progress: Called with the share that has been read.

    Raises:
        FileFormatError: One is not a recording of PCMRS or is one of a later version, or they are empty.
        OSError: One cannot be read.
    """
    for path in files:
        check_format(path)
    readings = [RecordingReader(path) for path in files]
    total, before = sum(each.size for each in readings), 0
    tracks: dict[str, MessageTrack] = defaultdict(MessageTrack)
    first = last = None
    for reading in readings:
        for at_ns, received in reading.bus_messages():
            first = at_ns if first is None else first
            last = at_ns
            _keep(tracks, received.key, (at_ns - first) / _SECOND, received.payload)
            progress((before + reading.whole) / total)
        before += reading.size
    if first is None or last is None:
        raise FileFormatError(f"{files[0]} holds no message of a cell.", file=str(files[0]))
    damage = "; ".join(f"{each.path.name}: {each.damage}" for each in readings if each.damage)
    return LoadedRecording(first / _SECOND, (last - first) / _SECOND, dict(tracks), damage)


class Playback(CellViewModel):
    """A recording at one moment.

    Args:
        recorded: The recording.
        setup: Setup of the cell that shows it.
        blueprint: Workflow of that cell.

    Attributes:
        position: The present moment, s since the beginning.
        trouble: Reason why a part of it is not shown; empty if all is.

    Raises:
        FileFormatError: It is of another workflow, or another arm.
    """

    def __init__(self, recorded: LoadedRecording, setup: Setup, blueprint: Blueprint) -> None:
        super().__init__()
        self.recorded = recorded
        self.position = 0.0
        self.trouble = recorded.damage
        self._all_events = [(recorded.started_at + at, event) for at, event in self._events()]
        self._shown: dict[str, int] = {}
        self._check(setup, blueprint)
        self.seek(0.0)

    @property
    def now(self) -> float:
        return self.position

    def seek(self, position: float) -> None:
        """Go to a moment, s since the beginning, limited to the recording."""
        self.position = min(max(position, 0.0), self.recorded.duration)
        for key, track in self.recorded.tracks.items():
            count = track.until(self.position)
            if count != self._shown.get(key, 0):
                self._shown[key] = count
                self._take(key, track, count)

    def _take(self, key: str, track: MessageTrack, count: int) -> None:
        """Show the newest of the first `count` messages, or nothing if there is none yet."""
        try:
            self._show(key, track, count)
        except PcmrsError as error:
            self.trouble = f"{key}: {error.text}"
        if key in WHOLE:
            self.version += 1

    def _show(self, key: str, track: MessageTrack, count: int) -> None:
        payload = track.payloads[count - 1] if count else None
        if key == "state/fsm":
            self.snapshot = _read(payload, Snapshot)
        elif key == "state/data":
            self.data = _read(payload, ProcedureDataView) or NOTHING
        elif key == "state/target" and "state/data" not in self.recorded.tracks:  # a recording from before that key
            target = _read(payload, Target) or Target()
            self.data = ProcedureDataView(
                landmarks=[], plan=target.pose, body_ref_from_image=target.body_ref_from_image
            )
        elif key == "state/event":
            self.events.clear()
            self.events.extend(self._all_events[max(0, count - EVENTS) : count])
        elif key == "state/epoch":
            self.epochs.clear()
            self.epochs.extend(unpack(each, Epoch) for each in track.payloads[max(0, count - EPOCHS) : count])
        elif key == "state/health":
            self.health = _read(payload, Health)
        elif key == "state/joints":
            self.joints = _read(payload, JointState)
            self._set_received("joints", track, count)
        elif key.startswith("state/pose/"):
            body = key.rpartition("/")[2]
            self.poses.pop(body, None)
            if payload is not None:
                self.poses[body] = unpack(payload, BodyPose)
            self._set_received(body, track, count)

    def _set_received(self, what: str, track: MessageTrack, count: int) -> None:
        self.received.pop(what, None)
        if count:
            self.received[what] = track.times[count - 1]

    def _events(self) -> list[tuple[float, Verdict | DeviceEvent]]:
        track = self.recorded.tracks.get("state/event", MessageTrack())
        return [
            (at, convert_event(unpack(payload, dict))) for at, payload in zip(track.times, track.payloads, strict=True)
        ]

    def _check(self, setup: Setup, blueprint: Blueprint) -> None:
        """Refuse a recording that this cell's page cannot show correctly."""
        states = self.recorded.tracks.get("state/fsm", MessageTrack())
        for payload in states.payloads[:1]:
            found = unpack(payload, Snapshot)
            unknown = [f"{b}={s}" for b, s in found.branches.items() if not _has(blueprint, b, s)]
            recorded, here = (f"{each.id} {each.version}" for each in (found.blueprint, blueprint))
            if unknown or found.blueprint.id != blueprint.id:
                text = f"The recording is of the workflow {recorded}, this cell's is {here}: "
                text += "open it in the console of a cell with that workflow."
                raise FileFormatError(text, recorded=recorded, unknown=unknown)
        for payload in self.recorded.tracks.get("state/joints", MessageTrack()).payloads[:1]:
            many, own = len(unpack(payload, JointState).positions), len(setup.arm.joints)
            if many != own:
                text = f"The recording is of an arm with {many} joints, {setup.arm.name} has {own}."
                raise FileFormatError(text, recorded=many, here=own)


def _keep(tracks: dict[str, MessageTrack], key: str, at: float, payload: bytes) -> None:
    if key in WHOLE:
        tracks[key].add(at, payload)
    elif key.startswith(THINNED):
        track = tracks[key]
        if not track.times or at - track.times[-1] >= 1.0 / RATE_HZ:
            track.add(at, payload)


def _read(payload: bytes | None, kind: type[T]) -> T | None:
    return None if payload is None else unpack(payload, kind)


def _has(blueprint: Blueprint, branch: str, state: str) -> bool:
    return branch in blueprint.branches and state in blueprint.branches[branch].states
