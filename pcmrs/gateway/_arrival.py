"""Times of arrival of datagrams and bytes that the event loop may read much later.

If the loop is held up, a command waits in the queue of its socket. It must not count as new when it is read: its sender
may not expect a motion any more. The earliest possible time of its arrival counts instead:

- `ReceiveWatch` asks the kernel periodically which sockets have nothing to read. Whatever is read later has arrived
  after that. It asks also while nothing arrives: an event loop does not say when it began to wait, so a socket that is
  readable after a rest of the watch could have been readable since the rest began.
- The kernel also stamps each datagram. It uses the wall clock, which may be set at any time, so a stamp counts only if
  it lies between the last empty queue and the present.

So a command never counts as newer than it is. Without a stamp, which TCP does not have, it may count as older: by
1 / `LOOKS_HZ`, or by the time for which the loop was held up.
"""

from __future__ import annotations

import fcntl
import select
import struct
from contextlib import suppress

from pcmrs.background import BackgroundTasks
from pcmrs.clock import Clock
from pcmrs.gateway.periodic_timer import PeriodicTask, kernel_beats

LOOKS_HZ = 50.0
"""Rate at which the kernel is asked for sockets with an empty queue."""

_SIOCGSTAMPNS = 0x8907
"""Request for the stamp of the datagram that was read last, socket(7). The first one switches the stamps on."""
_TIMESPEC = struct.Struct("@ll")


class ReceiveQueue:
    """Received data of one socket that the gateway has not taken yet.

    Args:
        since: Time at which nothing can have arrived yet, s of the machine's clock.

    Attributes:
        since: Last time at which nothing was waiting. What is taken next has arrived later.
        before: Last time but one.
        buffered: Number of bytes that were read from the socket and are not taken yet.
        descriptor: File descriptor of the socket, once it is open.
    """

    def __init__(self, since: float) -> None:
        self.since = self.before = since
        self.buffered = 0
        self.descriptor = -1


class ReceiveWatch:
    """Watch that knows since when data may be waiting at the sockets of the gateway.

    Args:
        clock: The machine's clock.
        tasks: Owner of the task that asks the kernel.
    """

    def __init__(self, clock: Clock, tasks: BackgroundTasks) -> None:
        self._clock = clock
        self._looks = PeriodicTask(kernel_beats, LOOKS_HZ, self.look, tasks)
        self._poll = select.poll()
        self._queues: dict[int, ReceiveQueue] = {}

    def start(self) -> None:
        """Begin to ask the kernel."""
        self._looks.start()

    def new_queue(self) -> ReceiveQueue:
        """Return the queue of a socket that is opened after this call."""
        return ReceiveQueue(self._clock.monotonic())

    def add(self, queue: ReceiveQueue, descriptor: int) -> None:
        """Watch a socket.

        Args:
            queue: Its queue.
            descriptor: Its file descriptor.
        """
        queue.descriptor = descriptor
        self._queues[descriptor] = queue
        self._poll.register(descriptor, select.POLLIN)

    def remove(self, queue: ReceiveQueue) -> None:
        """Stop watching a socket."""
        # Another socket may have this descriptor already: a transport closes its own when the peer is gone.
        if self._queues.get(queue.descriptor) is queue:
            del self._queues[queue.descriptor]
            self._poll.unregister(queue.descriptor)

    def look(self) -> None:
        """Note which queues are empty now."""
        now = self._clock.monotonic()  # before the kernel is asked: what arrives meanwhile is newer
        waiting = {descriptor for descriptor, _ in self._poll.poll(0)}
        for descriptor, queue in self._queues.items():
            if descriptor not in waiting and not queue.buffered:
                queue.before, queue.since = queue.since, now

    def look_at(self, queue: ReceiveQueue) -> None:
        """Note if one queue is empty now: that of a client that sends all the time may never be empty at a `look`."""
        now = self._clock.monotonic()
        poll = select.poll()
        poll.register(queue.descriptor, select.POLLIN)
        if not queue.buffered and not poll.poll(0):
            queue.before, queue.since = queue.since, now

    def add_stamped(self, queue: ReceiveQueue, descriptor: int) -> None:
        """Watch a UDP socket, and let the kernel stamp its datagrams if it can; see `add`."""
        self.add(queue, descriptor)
        with suppress(OSError):  # there is no datagram yet, or no stamps are available
            _stamp(descriptor)

    def arrival(self, queue: ReceiveQueue) -> float:
        """Return the time at which the datagram that was read last has arrived, s of the machine's clock."""
        now = self._clock.monotonic()
        try:
            arrived = now - (self._clock.wall() - _stamp(queue.descriptor))
        except OSError:
            return queue.since
        return arrived if queue.since <= arrived <= now else queue.since


def _stamp(descriptor: int) -> float:
    """Return the stamp of the datagram that was read last, Unix seconds."""
    seconds, nanoseconds = _TIMESPEC.unpack(fcntl.ioctl(descriptor, _SIOCGSTAMPNS, bytes(_TIMESPEC.size)))
    return float(seconds + nanoseconds * 1e-9)
