"""Connection to Dask: a scheduler with workers on this machine, or the scheduler of a cluster."""

from __future__ import annotations

import logging
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import resource_tracker
from urllib.parse import urlsplit

import dask
from distributed import Client, Future, LocalCluster, as_completed
from distributed.security import Security

from pcmrs.clock import SystemClock
from pcmrs.errors import ConfigurationError
from pcmrs.hosts import is_loopback
from pcmrs_lab.scale._errors import TaskFailedError
from pcmrs_lab.scale._worker import run_request

CONNECT_TIME = 10.0
"""Time limit for the connection to a cluster, s of the machine."""
CLOSE_TIME = 60.0
"""Time limit for the end of all workers, s of the machine: one that was killed may just be starting again."""
AHEAD = 2
"""Number of requests for each worker that the scheduler has, so that none waits for the client."""
FEWEST_AHEAD = 16
"""Number of requests that the scheduler of a cluster has at least: an adaptive one starts with no worker."""
COUNTED_EVERY = 5.0
"""Period after which the workers are counted again, s of the machine."""
RETRIES = 3
"""Number of times that a task is repeated if its worker or process ends."""
CONFIGURATION = {
    "distributed.scheduler.http.routes": [],
    "distributed.worker.http.routes": [],
    "distributed.worker.memory.terminate": False,
    "distributed.worker.memory.pause": False,
}
"""Configuration of a scheduler on this machine: no pages, and no limit of memory, which other processes use."""


class DaskPool:
    """Workers of Dask.

    Args:
        client: Connection to the scheduler.
        workers: Number of workers; None to count those of a cluster again and again.
    """

    def __init__(self, client: Client, workers: int | None) -> None:
        self._client = client
        self._workers = workers
        self._clock = SystemClock()
        self._counted, self._limit = -COUNTED_EVERY, 0

    def run(self, requests: Iterator[tuple[int, bytes]]) -> Iterator[tuple[int, bytes]]:
        """Run requests, and return their replies as they arrive.

        Args:
            requests: Numbers and requests; the next is taken when a worker may soon need it.

        Raises:
            TaskFailedError: A request could not be run.
        """
        running, numbers = as_completed(loop=self._client.loop), dict[str, int]()
        while True:
            while len(numbers) < self._most():
                if (request := next(requests, None)) is None:
                    break
                number, content = request
                future = self._client.submit(run_request, content, pure=False, retries=RETRIES)
                numbers[str(future.key)] = number
                running.add(future)
            if not numbers:
                return
            done = next(running)
            yield numbers.pop(str(done.key)), _reply(done)

    def _most(self) -> int:
        if self._workers is not None:
            return AHEAD * self._workers
        if self._clock.monotonic() - self._counted >= COUNTED_EVERY:
            self._counted = self._clock.monotonic()
            self._limit = max(FEWEST_AHEAD, AHEAD * sum(self._client.nthreads().values()))
        return self._limit


def _reply(done: Future[bytes]) -> bytes:
    try:
        reply: bytes = done.result()
    except Exception as error:
        raise TaskFailedError(f"No worker could end a task: {type(error).__name__}: {error}") from error
    return reply


@contextmanager
def local_pool(workers: int) -> Iterator[DaskPool]:
    """Start a scheduler and workers on this machine, for the length of the context.

    They speak TLS with keys of this run, since every account of a machine reaches its loopback addresses.

    Args:
        workers: Number of workers, each a process.
    """
    resource_tracker.ensure_running()  # its start would end the mask of the thread that starts the workers
    with dask.config.set(CONFIGURATION), _ctrl_c_blocked():  # threads and processes inherit the mask
        cluster = LocalCluster(
            n_workers=workers,
            threads_per_worker=1,
            host="127.0.0.1",
            dashboard_address="127.0.0.1:0",
            security=True,
            silence_logs=logging.CRITICAL,
            memory_limit=None,
        )
        client = Client(cluster, set_as_default=False)
    try:
        yield DaskPool(client, workers)
    finally:
        client.close(timeout=CLOSE_TIME)
        cluster.close(timeout=CLOSE_TIME)


@contextmanager
def cluster_pool(address: str) -> Iterator[DaskPool]:
    """Connect to a scheduler for the length of the context; files for TLS are those of Dask's configuration.

    Args:
        address: Address of the scheduler, such as ``tls://scheduler:8786``.

    Raises:
        ConfigurationError: The address is refused, TLS is not configured, or nothing answers.
    """
    check_address(address)
    security = Security(require_encryption=True) if address.startswith("tls://") else Security()
    if security.require_encryption and security.get_connection_args("client")["ssl_context"] is None:
        raise ConfigurationError(
            f"{address} needs certificates: set distributed.comm.tls.ca-file and distributed.comm.tls.client in "
            "Dask's configuration (docs/scale.md)."
        )
    try:
        with _ctrl_c_blocked():
            client = Client(address, security=security, timeout=CONNECT_TIME, set_as_default=False)
    except OSError as error:
        raise ConfigurationError(f"No Dask scheduler answers at {address}: {error}") from None
    try:
        yield DaskPool(client, None)
    finally:
        client.close(timeout=CLOSE_TIME)


def check_address(address: str) -> None:
    """Refuse the address of a scheduler that is neither encrypted nor on this machine.

    A scheduler runs what it is sent, and a client unpickles what it receives.

    Args:
        address: Address such as ``tls://scheduler:8786``.

    Raises:
        ConfigurationError: It is refused.
    """
    try:
        parts = urlsplit(address)
        host, port = parts.hostname, parts.port
    except ValueError:
        host = port = None
    # Dask takes the scheme as it is written.
    if host is None or port is None or not address.startswith(("tls://", "tcp://")):
        raise ConfigurationError(f"{address} is not a scheduler's address: write tls://HOST:PORT.")
    if parts.scheme == "tcp" and not is_loopback(host):
        raise ConfigurationError(
            f"{address} is neither encrypted nor on this machine, and a Dask scheduler runs what it is sent: "
            "use tls://HOST:PORT, or tcp://127.0.0.1:PORT on this machine (docs/scale.md)."
        )


@contextmanager
def _ctrl_c_blocked() -> Iterator[None]:
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
