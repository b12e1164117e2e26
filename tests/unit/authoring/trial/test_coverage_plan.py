"""Tours through a world that ends operations as it likes: everything it can give is seen, and the tour ends."""

from __future__ import annotations

from random import Random

from hypothesis import given
from hypothesis import strategies as st

from pcmrs.authoring.trial.coverage_plan import CoveragePlan
from pcmrs.authoring.trial.tour import TourCommand, all_moves
from pcmrs.fsm import Blueprint
from tests.support.trials import examples
from tests.unit.fsm.random_blueprints import blueprints


def same_command(move: TourCommand, other: TourCommand) -> bool:
    return (move.name, move.asker) == (other.name, other.asker)


class World:
    """Ends commands at random, and some of them never in a certain way; where it drifts it does not stay."""

    def __init__(self, blueprint: Blueprint, rng: Random, never: float, drifting: float) -> None:
        self.moves = all_moves(blueprint)
        self.never = {move for there in self.moves.values() for move in there if rng.random() < never}
        joints = list(self.moves)
        self.drift = {joint: rng.choice(joints) for joint in joints if rng.random() < drifting}
        self._rng = rng

    def end(self, move: TourCommand) -> TourCommand | None:
        """How the command of a move has ended; None when the world has done nothing."""
        possible = [m for m in self.moves[move.before] if same_command(m, move) and m not in self.never]
        return self._rng.choice(possible) if possible else None


def tour(world: World, start: tuple[str, ...], most: int) -> tuple[set[TourCommand], dict[TourCommand, str]]:
    agenda = CoveragePlan(world.moves, {})
    seen: set[TourCommand] = set()
    here = start
    for _ in range(most):
        move = agenda.next(here, lambda _: True)
        if move is None:
            return seen, agenda.unseen()
        assert move.before == here
        ended = world.end(move)
        if ended is not None:
            agenda.made(ended)
            seen.add(ended)
            here = world.drift.get(ended.after, ended.after)
        if ended != move or here != ended.after:
            agenda.missed(move, "the world does not want it")
    raise AssertionError(f"no end after {most} commands; {len(agenda)} are left")


@given(blueprints(), st.randoms(use_true_random=False), st.sampled_from([0, 0.1, 0.5]), st.sampled_from([0, 0.2]))
@examples(40)
def test_a_tour_ends_and_says_what_is_left(blueprint: Blueprint, rng: Random, never: float, drifting: float) -> None:
    world = World(blueprint, rng, never, drifting)
    everything = {move for there in world.moves.values() for move in there}
    seen, left = tour(world, tuple(blueprint.initial().values()), 200 * len(everything))
    assert seen | set(left) == everything
    assert not seen & set(left)
    assert not seen & world.never


def test_dropped_move_is_never_walked_again() -> None:
    here, there = ("a",), ("b",)
    way = TourCommand(branch="x", operation="go", ending="done", before=here, after=there)
    goal = TourCommand(branch="x", operation="stay", ending="done", before=there, after=there)
    agenda = CoveragePlan({here: [way], there: [goal]}, {})
    agenda.made(way)
    assert agenda.next(here, lambda _: True) == way
    agenda.drop(lambda move: move == way)
    assert agenda.next(here, lambda _: True) is None
    assert agenda.unseen() == {goal: ""}


def test_missed_move_is_tried_again_after_another_was_made() -> None:
    here = ("a",)
    shy, bold = (
        TourCommand(branch="x", operation=name, ending="done", before=here, after=here) for name in ("shy", "bold")
    )
    agenda = CoveragePlan({here: [shy, bold]}, {"x.shy": 1})
    assert agenda.next(here, lambda _: True) == shy
    agenda.missed(shy, "not now")
    assert agenda.next(here, lambda _: True) == bold
    agenda.made(bold)
    assert agenda.next(here, lambda _: True) == shy
    agenda.missed(shy, "not now")
    assert agenda.next(here, lambda _: True) is None
    assert agenda.unseen() == {shy: "not now"}


def test_impossible_move_is_neither_wanted_nor_walked() -> None:
    here, there = ("a",), ("b",)
    motion = TourCommand(branch="x", operation="move", ending="done", before=here, after=there)
    agenda = CoveragePlan({here: [motion], there: []}, {})
    assert agenda.next(here, lambda move: move.operation != "move") is None
    assert agenda.towards(here, {there}, lambda move: move.operation != "move") is None
    assert agenda.towards(here, {there}, lambda _: True) == motion
