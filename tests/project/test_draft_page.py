"""The example of `docs/draft.md`: each command prints what the page shows, with a model that gives made answers."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from click.testing import CliRunner

from pcmrs.authoring.drafting.model import ModelSettings
from pcmrs.cli import main
from pcmrs.clock import SystemClock
from pcmrs.pki import Authority
from tests import ROOT
from tests.unit.authoring.drafting.made_answers import PROTOCOL, RIGHT, SLIGHTLY_WRONG
from tests.unit.authoring.drafting.model_server import answering, served

PAGE = (ROOT / "docs" / "draft.md").read_text()
(SHOWN_PROTOCOL,) = re.findall(r"^```markdown\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)
SHOWN = [
    (command.split(), output.splitlines())
    for block in re.findall(r"^```console\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)
    for command, output in re.findall(r"^\$ pcmrs (.*)\n((?:[^$].*\n)*)", block, re.MULTILINE)
]


def test_commands_of_the_page_print_what_it_shows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert SHOWN_PROTOCOL == PROTOCOL
    assert [words[1] for words, _ in SHOWN] == ["draft", "design", "verify", "approve"]
    monkeypatch.chdir(tmp_path)
    for name in ("http_proxy", "https_proxy", "all_proxy", "HTTP_PROXY", "HTTPS_PROXY", "ALL_PROXY"):
        monkeypatch.delenv(name, raising=False)
    Path("protocol.md").write_text(SHOWN_PROTOCOL)
    now = SystemClock().wall()
    Authority.init(Path("pki"), "lab", now).issue("operator", "anna", now, cells=["lab/cell1"], into=Path())
    with served(answering(SLIGHTLY_WRONG), answering(RIGHT)) as server:
        monkeypatch.setenv("PCMRS_MODEL_URL", server.url)
        monkeypatch.setenv("PCMRS_MODEL", "made")
        for words, shown in SHOWN:
            result = CliRunner().invoke(main, words)
            assert result.exit_code == 0, result.output
            printed = result.output.splitlines()
            if shown[-1] == "…":
                shown, printed = shown[:-1], printed[: len(shown) - 1]
            assert len(printed) == len(shown), result.output
            for line, expected in zip(printed, shown, strict=True):
                begin, _, _ = expected.partition("…")
                assert line.startswith(begin)


def test_keys_of_the_page_are_those_of_the_settings() -> None:
    table = PAGE.partition("| key | default |")[2].partition("\n\n")[0]
    named = {key for row in table.splitlines() for key in re.findall(r"`(\w+)`", row.split("|")[1] if row else "")}
    assert named | {"url", "model"} == set(ModelSettings.__struct_fields__)
