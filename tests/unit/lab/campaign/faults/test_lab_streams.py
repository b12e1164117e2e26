"""The row of a stream from another machine: not found by default, found where a lab says so, with a warning."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from pcmrs.testing.errors import Unmet
from pcmrs_lab.campaign.fault import NotRun
from pcmrs_lab.campaign.faults import lab_streams
from pcmrs_lab.campaign.faults.lab_streams import OFFER, WARNING, Read
from pcmrs_lab.campaign.sham import sham
from tests.unit.lab.campaign.faults.operated import OperatedCell, lab_of, proves, run

COUNTED = "Tcp: RtoAlgorithm InSegs OutSegs\nTcp: 1 42 7\n"
NOT_FOUND = '{"samples": 0, "problem": "EMG has not been found."}\n'


class Script:
    """A process that has written these lines before it is ready, and this at its end."""

    def __init__(self, log: str, last: str, *, ready: bool = True) -> None:
        self._lines = iter([*log.splitlines(keepends=True), *(["ready\n"] if ready else []), ""])
        self._last = last
        self.stdout = SimpleNamespace(readline=lambda: next(self._lines))

    def wait(self, within: float) -> None:
        raise subprocess.TimeoutExpired("reader", within)

    def communicate(self) -> tuple[str, str]:
        return "a line of the log\n" + self._last, ""


class Net:
    """Two machines: what a reader finds by default, and what with a lab's own file."""

    def __init__(self) -> None:
        self.log_by_default, self.log_of_wider = "", f"warning: {WARNING}\n"
        self.by_default, self.wider = NOT_FOUND, '{"samples": 100, "problem": ""}\n'
        self.offered = 0

    def start(self, machine: str, *words: str, **_: Any) -> Script:
        if words[-1] == OFFER:
            self.offered += 1
            assert machine == "other"
            return Script("", "")
        opened = any(word.startswith("LSLAPICFG=") for word in words)
        if not self.offered:
            return Script(self.log_of_wider if opened else self.log_by_default, NOT_FOUND)
        return Script(*((self.log_of_wider, self.wider) if opened else (self.log_by_default, self.by_default)))

    def run(self, *_: str) -> Any:
        return SimpleNamespace(stdout=COUNTED)


@pytest.fixture
def net(monkeypatch: pytest.MonkeyPatch) -> Net:
    made = Net()

    @contextmanager
    def lan() -> Iterator[Net]:
        yield made

    monkeypatch.setattr(lab_streams, "lan", lan)
    return made


def test_a_stream_of_another_machine_is_not_found(net: Net, tmp_path: Path) -> None:
    found = lab_streams._offered(tmp_path)
    assert proves(found)
    assert found.took_place == {"tcp_segments_at_the_cells_machine": 42}
    assert found.control == {"samples_with_the_scope_opened": 100, "logged_where_it_is_opened": WARNING}
    assert "ResolveScope = link" in (tmp_path / "lsl_api.cfg").read_text()


@pytest.mark.parametrize(
    ("changed", "text"),
    [
        ({"wider": NOT_FOUND}, "With the scope opened, too, nothing was read: EMG has not been found"),
        ({"log_of_wider": ""}, "No warning is logged although the scope is opened"),
        ({"log_by_default": f"{WARNING}\n"}, "By default a warning is logged"),
        ({"by_default": '{"samples": 3, "problem": ""}\n'}, "By default 3 samples of another machine were read"),
        ({"by_default": '{"samples": 0, "problem": "It is broken."}\n'}, "By default another reason is given"),
    ],
)
def test_anything_else_is_unmet(net: Net, tmp_path: Path, changed: dict[str, str], text: str) -> None:
    for name, value in changed.items():
        setattr(net, name, value)
    with pytest.raises(Unmet, match=text):
        lab_streams._offered(tmp_path)


def test_a_stream_that_was_not_offered_is_found_out(net: Net, tmp_path: Path) -> None:
    with sham(), pytest.raises(Unmet, match="With the scope opened, too, nothing was read"):
        lab_streams._offered(tmp_path)
    assert net.offered == 0


def test_a_reader_has_read_what_its_last_line_says() -> None:
    read = lab_streams._read(cast(Any, Script("", '{"samples": 7, "problem": ""}\n')), 0.0)
    assert read == Read(7, "")


def test_a_script_that_ends_before_it_is_ready_is_unmet() -> None:
    assert lab_streams._until_ready(cast(Any, Script("one\ntwo\n", ""))) == "one\ntwo\n"
    with pytest.raises(Unmet, match="The script has ended: no such module"):
        lab_streams._until_ready(cast(Any, Script("no such module\n", "", ready=False)))


def test_a_machine_with_its_own_configuration_is_not_tested(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(lab_streams, "lab_configuration", lambda: "/etc/lsl_api.cfg")
    with pytest.raises(NotRun, match=r"/etc/lsl_api\.cfg configures"):
        run(monkeypatch, lab_streams.stream_of_another_machine(lab_of(tmp_path, OperatedCell())))
