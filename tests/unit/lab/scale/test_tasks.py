"""Seeded tasks: the same results wherever they run, whoever is killed, and however often a run is interrupted."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from itertools import islice
from pathlib import Path

import dask
import pytest
from distributed import LocalCluster
from distributed.security import Security

from pcmrs.errors import ConfigurationError
from pcmrs.testing.daemon import free_port
from pcmrs_lab.scale import _dask
from pcmrs_lab.scale.tasks import HERE, TaskFailedError, Workers, run_tasks
from tests.unit.lab.scale.drawing import Drawn, DrawTask, draw, fail, started

TWO = Workers(2)
PATIENCE = 60.0

pytestmark = pytest.mark.timeout(300)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "go").touch()
    return tmp_path


def results(folder: Path, seeds: range, workers: Workers, at_once: int = 2) -> dict[int, Drawn]:
    found = list(run_tasks(draw, (DrawTask(seed, str(folder)) for seed in seeds), workers, at_once))
    assert len(found) == len(seeds)
    return {task.seed: result for task, result in found}


def until(condition: Callable[[], bool]) -> None:
    end = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)


def is_running(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False


def test_two_workers_find_what_one_finds(folder: Path) -> None:
    here = results(folder, range(10), HERE)
    assert results(folder, range(10), TWO, at_once=3) == here
    assert len({each.identifier for each in here.values()}) == 10
    assert here[3].endless == float("inf")
    processes = {each.process for each in started(folder)}
    assert os.getpid() in processes
    assert len(processes) == 3
    until(lambda: not any(is_running(each) for each in processes - {os.getpid()}))


@pytest.mark.parametrize("of", ["worker", "process"])
def test_killed_in_the_middle_all_results_are_there(of: str, tmp_path: Path) -> None:
    """The worker, or the process of its task; of both nothing is left."""

    def kill() -> None:
        until(lambda: len({each.worker for each in started(tmp_path)}) == 2)
        killed.append(started(tmp_path)[0].process)
        os.kill(getattr(started(tmp_path)[0], of), signal.SIGKILL)
        until(lambda: not is_running(killed[0]))
        (tmp_path / "go").touch()

    killed: list[int] = []
    killer = threading.Thread(target=kill)
    killer.start()
    found = results(tmp_path, range(8), TWO)
    killer.join()
    again = [each.seed for each in started(tmp_path)]
    assert len(again) > len(set(again)) == 8
    assert found == results(tmp_path, range(8), HERE)


@pytest.mark.parametrize("workers", [1, 2])
def test_interrupted_and_taken_up_again(workers: int, folder: Path) -> None:
    where = Workers(workers, finished=folder / "finished.jsonl")
    tasks = [DrawTask(seed, str(folder)) for seed in range(30)]
    run = run_tasks(draw, tasks, where, 1)
    first = {task.seed: result for task, result in islice(run, 3)}
    run.close()
    kept = len((folder / "finished.jsonl").read_bytes().splitlines())
    assert kept >= 3
    before = len(started(folder))
    whole = results(folder, range(30), where)
    assert whole == first | whole == results(folder, range(30), HERE)
    assert len(started(folder)) == before + 30 - kept + 30
    assert results(folder, range(30), where) == whole
    assert len(started(folder)) == before + 30 - kept + 30, "nothing is run again"


def test_tasks_are_taken_only_when_they_are_needed(folder: Path) -> None:
    taken: list[int] = []

    def tasks() -> Iterator[DrawTask]:
        for seed in range(1000):
            taken.append(seed)
            yield DrawTask(seed, str(folder))

    run = run_tasks(draw, tasks(), TWO, 2)
    next(run)
    run.close()
    assert len(taken) < 30


def test_the_error_of_a_task_names_itself(folder: Path) -> None:
    with pytest.raises(TaskFailedError, match=r"GeometryError: Seed 4 has no numbers\."):
        list(run_tasks(fail, [DrawTask(4, str(folder))], TWO, 1))


def test_a_worker_of_another_version_is_refused(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pcmrs_lab.scale.tasks.code_version", lambda: "another")
    with pytest.raises(TaskFailedError, match="another version"):
        results(folder, range(1), TWO)


def test_no_tasks_have_no_results() -> None:
    assert list(run_tasks(draw, [], HERE, 1)) == []


@pytest.mark.parametrize(
    "address",
    [
        "tcp://192.0.2.1:8786",
        "tcp://scheduler:8786",
        "tcp://localhost:8786",
        "tcp://0.0.0.0:8786",
        "ws://127.0.0.1:8786",
        "inproc://1",
        "scheduler:8786",
        "127.0.0.1:8786",
        "tls://scheduler",
        "tls://:8786",
        "tcp://127.0.0.1:99999",
        "tcp://[::1:8786",
    ],
)
def test_unencrypted_addresses_elsewhere_are_refused(address: str) -> None:
    with pytest.raises(ConfigurationError, match="tls://HOST:PORT"):
        list(run_tasks(draw, [], Workers(cluster=address), 1))


@pytest.mark.parametrize("encrypted", [False, True])
def test_a_cluster_finds_what_this_process_finds(encrypted: bool, folder: Path) -> None:
    """On loopback addresses, or with the certificates of Dask's own configuration."""
    keys = Security.temporary()
    (folder / "cert.pem").write_text(keys.tls_ca_file)
    (folder / "key.pem").write_text(keys.tls_client_key)
    own = {"cert": str(folder / "cert.pem"), "key": str(folder / "key.pem")}
    files = {"ca-file": own["cert"], "client.cert": own["cert"], "client.key": own["key"]}
    tls = {f"distributed.comm.tls.{name}": file for name, file in files.items()} if encrypted else {}
    security = keys if encrypted else Security()
    pages: dict[str, object] = {"distributed.scheduler.http.routes": [], "distributed.worker.http.routes": []}
    with (
        dask.config.set(tls | pages),
        LocalCluster(n_workers=1, host="127.0.0.1", dashboard_address="127.0.0.1:0", security=security) as cluster,
    ):
        address = cluster.scheduler_address
        assert address.startswith("tls://" if encrypted else "tcp://127.0.0.1:")
        assert results(folder, range(5), Workers(cluster=address)) == results(folder, range(5), HERE)


def test_a_cluster_that_does_not_answer_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(_dask, "CONNECT_TIME", 0.2)
    with pytest.raises(ConfigurationError, match=r"No Dask scheduler answers at tcp://127\.0\.0\.1:"):
        list(run_tasks(draw, [], Workers(cluster=f"tcp://127.0.0.1:{free_port()}"), 1))


def test_tls_without_certificates_is_refused() -> None:
    with pytest.raises(ConfigurationError, match=r"distributed\.comm\.tls\.ca-file"):
        list(run_tasks(draw, [], Workers(cluster="tls://192.0.2.1:8786"), 1))
