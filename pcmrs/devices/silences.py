"""Events of a node that did not hear the daemon: what they mean, and what the machine had to do then."""

from __future__ import annotations

from pcmrs.devices.deadman import Silence
from pcmrs.messages import DeviceEvent
from pcmrs.threads import Load


def daemon_silent(device: str, silence: Silence, limit: float, load: Load) -> DeviceEvent:
    """The node has made its device safe by itself: danger.

    Args:
        device: That moved, or could have fired.
        silence: Of the daemon.
        limit: Of the deadman, s of the machine.
        load: Of the node's machine, just afterwards.
    """
    text = f"The node of the {device} has made it safe by itself: it had not heard the daemon for "
    text += f"{silence.lasted * 1e3:.0f} ms, limit {limit * 1e3:.0f} ms.{_why(silence, load)} "
    text += "Nothing goes on by itself: look, and acknowledge."
    fields = {"silence": silence.lasted, "limit": limit, **_fields(silence, load)}
    return DeviceEvent(device=device, code="daemon_silent", text=text, danger=True, fields=fields)


def node_held_up(device: str, silence: Silence, load: Load) -> DeviceEvent:
    """The node itself was not served by its machine, and so could not hear the daemon in time.

    Args:
        device: That it watches over.
        silence: As it seemed before the node had taken what had arrived meanwhile.
        load: Of the node's machine, just afterwards.
    """
    text = f"The node of the {device} was held up.{_why(silence, load)} pcmrs-serve says at its start what it lacks "
    text += "to go ahead of other programs; stop some of those."
    return DeviceEvent(device=device, code="node_held_up", text=text, fields=_fields(silence, load))


def _why(silence: Silence, load: Load) -> str:
    if silence.held_up:
        return f" The node had waited {silence.held_up * 1e3:.0f} ms for a processor: {load}."
    return f" The machine is overloaded: {load}." if load.running > load.processors else ""


def _fields(silence: Silence, load: Load) -> dict[str, float]:
    return {"held_up": silence.held_up, "running": load.running, "processors": load.processors}
