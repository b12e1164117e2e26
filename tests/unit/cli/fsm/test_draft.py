"""`pcmrs fsm draft`: what it writes, and how it ends."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

from pcmrs.cli import main
from tests.unit.authoring.drafting.made_answers import ALIGNED, PROTOCOL, RIGHT, SLIGHTLY_WRONG, changed
from tests.unit.authoring.drafting.model_server import answering, failing, refusing, served

Draft = Callable[..., Result]


@pytest.fixture(autouse=True)
def _no_proxy(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("http_proxy", "https_proxy", "all_proxy", "HTTP_PROXY", "HTTPS_PROXY", "ALL_PROXY"):
        monkeypatch.delenv(name, raising=False)


@pytest.fixture
def protocol(tmp_path: Path) -> Path:
    file = tmp_path / "protocol.md"
    file.write_text(PROTOCOL)
    return file


def drafted(url: str, *words: object, **more: Any) -> Result:
    environment = {"PCMRS_MODEL_URL": url, "PCMRS_MODEL": "made", "PCMRS_MODEL_KEY": "secret"}
    return CliRunner().invoke(main, ["fsm", "draft", *map(str, words)], env=environment, **more)


def test_a_proved_draft_is_written_and_its_questions_shown(protocol: Path, tmp_path: Path) -> None:
    output, picture = tmp_path / "table.toml", tmp_path / "draft.svg"
    with served(answering(SLIGHTLY_WRONG), answering(RIGHT)) as server:
        result = drafted(server.url, protocol, "-o", output, "--plot", picture)
    assert result.exit_code == 0, result.output
    assert server.requests[0]["key"] == "Bearer secret"
    lines = result.stderr.splitlines()
    assert lines[0].startswith("Round 1: 1 finding: requirement ready: property_violated")
    assert lines[1:] == [
        "Round 2: proved",
        "200 tokens sent, 100 received.",
        "Assumed: The guide stays at the path.",
        "Question: Who confirms the insertion?",
    ]
    assert tomllib.loads(output.read_text())["provenance"]["model"] == "made"
    assert picture.read_text().startswith("<svg")


def test_an_unsound_draft_is_written_with_its_findings(protocol: Path, tmp_path: Path) -> None:
    output, picture = tmp_path / "table.toml", tmp_path / "draft.svg"
    with served(answering(SLIGHTLY_WRONG)) as server:
        result = drafted(server.url, protocol, "-o", output, "--rounds", "2", "--plot", picture)
    assert result.exit_code == 1
    (finding,) = tomllib.loads(output.read_text())["unresolved"]
    assert finding in result.stderr
    assert not picture.exists()
    designed = CliRunner().invoke(main, ["fsm", "design", str(output), "-o", str(tmp_path / "blueprint.toml")])
    assert designed.exit_code == 1
    assert "draft_unresolved" in designed.stderr
    assert not (tmp_path / "blueprint.toml").exists()


def test_differences_from_an_earlier_table_are_listed(protocol: Path, tmp_path: Path) -> None:
    earlier = tmp_path / "earlier.toml"
    with served(answering(RIGHT)) as server:
        assert drafted(server.url, protocol, "-o", earlier).exit_code == 0
        same = drafted(server.url, protocol, "--diff", earlier, "--json")
    without = changed(lambda answer: answer["steps"][1].pop("reopened_by"))
    with served(answering(without)) as server:
        other = drafted(server.url, protocol, "--diff", earlier, "--json")
    assert json.loads(same.stdout)["differences"] == ["The same behaviour."]
    assert any("withdraw" in each for each in json.loads(other.stdout)["differences"])


def test_the_result_is_printed_as_one_json_object(protocol: Path) -> None:
    with served(answering("no table"), answering(RIGHT)) as server:
        result = drafted(server.url, protocol, "--json")
    said = json.loads(result.stdout)
    assert (said["proved"], said["findings"], len(said["rounds"])) == (True, [], 2)
    assert said["rounds"][0]["table"] is None
    assert said["rounds"][1]["table"]["steps"][1]["source"] == ALIGNED


@pytest.mark.parametrize("reply", [refusing("no"), failing(401), answering("no table")])
def test_without_a_table_nothing_is_written(reply: Any, protocol: Path, tmp_path: Path) -> None:
    with served(reply) as server:
        result = drafted(server.url, protocol, "-o", tmp_path / "table.toml", "--rounds", "2")
    assert result.exit_code == 5
    assert not (tmp_path / "table.toml").exists()
    assert "secret" not in result.output


def test_nothing_is_sent_that_looks_like_data_of_a_patient(protocol: Path) -> None:
    protocol.write_text(PROTOCOL + "Patient: Jane Doe\n")
    with served(answering(RIGHT)) as server:
        refused = drafted(server.url, protocol)
        assert server.requests == []
        sent = drafted(server.url, protocol, "--reviewed")
    assert refused.exit_code == 5
    assert f"{protocol}:7: This looks like the name of a patient." in refused.stderr
    assert "Jane" not in refused.output
    assert "--reviewed" in refused.stderr
    assert sent.exit_code == 0


def test_the_configuration_may_hold_address_and_model(protocol: Path, tmp_path: Path) -> None:
    config = tmp_path / "model.toml"
    with served(answering(RIGHT)) as server:
        config.write_text(f'url = "{server.url}"\nmodel = "configured"\nrequest_price = 1e4\n')
        result = CliRunner().invoke(main, ["fsm", "draft", str(protocol), "--config", str(config)])
    assert result.exit_code == 0, result.output
    assert server.requests[0]["model"] == "configured"
    assert ", cost 1." in result.stderr


@pytest.mark.parametrize(
    ("words", "status"), [([], 2), (["p.md", "--evaluate"], 2), (["none.md"], 5), (["-", "--json", "-o", "-"], 2)]
)
def test_what_cannot_be_meant_is_refused(words: list[str], status: int) -> None:
    assert drafted("http://127.0.0.1:9/v1", *words).exit_code == status


def test_without_an_address_the_command_says_how_to_set_it(protocol: Path) -> None:
    result = drafted("", protocol)
    assert result.exit_code == 4
    assert "PCMRS_MODEL_URL" in result.stderr


def test_evaluation_counts_the_properties_of_each_protocol() -> None:
    """A model that always gives the same answer has the properties of one protocol at most."""
    right = (Path(__file__).parents[2] / "authoring" / "drafting" / "right" / "biopsy.json").read_text()
    with served(answering(right)) as server:
        result = drafted(server.url, "--evaluate", "--rounds", "1")
        as_json = drafted(server.url, "--evaluate", "--rounds", "1", "--json")
    assert result.exit_code == 0, result.output
    lines = result.stdout.splitlines()
    assert lines[0].startswith("made, at most 1 rounds")
    assert len(lines) == 1 + 12 + 1
    assert "biopsy                   11 of 11, proved" in lines
    assert "catheter                 0 of " in result.stdout
    found = {each["protocol"]: each for each in json.loads(as_json.stdout)["protocols"]}
    assert found["biopsy"]["held"] == [11]
    assert found["ratms"]["proved"] is False


def test_evaluation_goes_on_after_a_refusal() -> None:
    with served(refusing("no")) as server:
        result = drafted(server.url, "--evaluate")
    assert result.exit_code == 0
    assert result.stdout.count("no answer of ") == 12
    assert len(server.requests) == 12
