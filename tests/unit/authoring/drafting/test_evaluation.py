"""The twelve protocols: their right workflows have all properties, and others are found to lack some."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from pcmrs.authoring.drafting._answer import examine_answer
from pcmrs.authoring.drafting.evaluation import EvaluationProtocol, evaluate, evaluation_protocols, missing_properties
from pcmrs.authoring.drafting.loop import draft
from pcmrs.authoring.drafting.text_checks import warnings_of
from pcmrs.fsm.blueprint import ProvenanceSpec
from tests.unit.authoring.drafting.made_answers import asking
from tests.unit.authoring.drafting.model_server import answering, served

RIGHT = Path(__file__).parent / "right"
ORIGIN = ProvenanceSpec(model="made", prompt="", protocol="", date="")
PROTOCOLS = evaluation_protocols()
EACH = pytest.mark.parametrize("protocol", PROTOCOLS, ids=lambda protocol: protocol.name)


def right(protocol: EvaluationProtocol) -> dict[str, Any]:
    answer: dict[str, Any] = json.loads((RIGHT / f"{protocol.name}.json").read_text())
    return answer


def missing(protocol: EvaluationProtocol, answer: dict[str, Any]) -> list[str]:
    examined = examine_answer(json.dumps(answer), protocol.text, ORIGIN, complete=True)
    assert examined.table is not None
    return missing_properties(examined.table, protocol.properties)


def test_there_are_twelve_protocols_without_data_of_patients() -> None:
    assert len(PROTOCOLS) == 12
    assert [warnings_of(protocol.text) for protocol in PROTOCOLS] == [[]] * 12
    assert {path.stem for path in RIGHT.iterdir()} == {protocol.name for protocol in PROTOCOLS}


@EACH
def test_the_right_workflow_is_proved_and_has_all_properties(protocol: EvaluationProtocol) -> None:
    examined = examine_answer(json.dumps(right(protocol)), protocol.text, ORIGIN, complete=True)
    assert [str(finding) for finding in examined.findings] == []
    assert missing_properties(examined.table, protocol.properties) == []


@EACH
def test_sentences_of_properties_are_those_of_the_protocol(protocol: EvaluationProtocol) -> None:
    sentences = protocol.text.splitlines()
    for each in protocol.properties:
        assert {each.sentence, *each.holds} <= set(sentences)
        assert bool(each.holds) != bool(each.declares)


@EACH
def test_a_workflow_without_dependencies_lacks_their_properties(protocol: EvaluationProtocol) -> None:
    answer = right(protocol)
    answer["steps"] = [each | {"depends_on": []} for each in answer["steps"]]
    assert missing(protocol, answer) == [each.id for each in protocol.properties if each.holds]


@EACH
def test_a_workflow_without_declarations_lacks_those(protocol: EvaluationProtocol) -> None:
    answer = right(protocol)
    harmless = {"moves": False, "affects_patient": False, "irreversible": False, "confirm": False}
    answer["steps"] = [each | harmless for each in answer["steps"]]
    assert missing(protocol, answer) == [each.id for each in protocol.properties if each.declares]


@EACH
def test_a_missing_step_lacks_the_properties_that_need_it(protocol: EvaluationProtocol) -> None:
    answer = right(protocol)
    last = answer["steps"].pop()
    expected = [each.id for each in protocol.properties if last["source"] in (each.sentence, *each.holds)]
    assert missing(protocol, answer) == expected
    assert expected


def test_no_table_and_no_workflow_have_no_properties() -> None:
    protocol = PROTOCOLS[0]
    everything = [each.id for each in protocol.properties]
    assert missing_properties(None, protocol.properties) == everything
    answer = right(protocol)
    answer["steps"][0]["depends_on"] = ["nothing"]
    assert missing(protocol, answer) == everything


async def test_properties_are_counted_after_each_round() -> None:
    protocol = PROTOCOLS[0]
    wrong = right(protocol)
    wrong["steps"][-1]["depends_on"] = ["nothing"]
    replies = [answering(json.dumps(each)) for each in (wrong, right(protocol))]
    with served(*replies) as server:
        async with asking(server.url) as asked:
            done = evaluate(protocol, await draft(protocol.text, asked.client, "2026-11-27"))
    assert (done.held, done.missing, done.proved) == ([0, done.properties], [], True)
