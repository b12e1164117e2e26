"""The tour of RATMS."""

from __future__ import annotations

from functools import cache

from pcmrs.authoring.trial.tour import Tour, plan_tour
from pcmrs.fsm import Blueprint
from tests.support.shipped import shipped_blueprint

RATMS = shipped_blueprint("ratms")


@cache
def ratms_tour() -> Tour:
    return plan_tour(RATMS)


def check_connected(blueprint: Blueprint, tour: Tour) -> None:
    start = tuple(blueprint.initial().values())
    for stretch in tour.stretches:
        befores = [move.before for move in stretch]
        assert befores == [start, *(move.after for move in stretch)][: len(befores)]
