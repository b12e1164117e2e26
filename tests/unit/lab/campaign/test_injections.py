"""Every row of the catalogue is injected, and each way says how."""

from __future__ import annotations

import inspect
from importlib import import_module

import pytest

from pcmrs_lab.campaign.catalogue import CLASSES, catalogue, choose
from pcmrs_lab.campaign.fault import SENDERS
from pcmrs_lab.campaign.injections import injections


@pytest.mark.parametrize("fault_class", CLASSES)
def test_every_row_of_a_class_is_injected(fault_class: str) -> None:
    rows = choose([fault_class])
    assert not {row.id for row in rows} - injections().keys()
    for row in rows:
        ways = [way.how for way in injections()[row.id]]
        assert all(ways)
        assert len(set(ways)) == len(ways)


def test_nothing_is_injected_that_the_catalogue_does_not_have() -> None:
    assert injections().keys() == catalogue().keys()


def test_loading_the_injections_again_registers_nothing_twice() -> None:
    before = {name: len(ways) for name, ways in injections().items()}
    assert {name: len(ways) for name, ways in injections().items()} == before


def test_rows_of_input_have_a_permitted_control_or_a_mutant() -> None:
    """`run_injection` says so of each row that is run; this of all of them, in the sources."""
    modules = {
        way.run.__module__ for row in catalogue().values() if row.fault_class in SENDERS for way in injections()[row.id]
    }
    assert len(modules) > 10
    assert [name for name in sorted(modules) if '"without_fault"' in inspect.getsource(import_module(name))] == []


def test_a_way_is_the_function_that_a_report_names() -> None:
    """Two ways of one row have different names: a test picks one of them by it."""
    for ways in injections().values():
        assert len({way.name for way in ways}) == len(ways)
        assert all(way.deadline >= 30.0 for way in ways)
