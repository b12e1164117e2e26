"""What one run of the daemon leaves to the next, worked out anew: data, doubts, the latch, and what had begun."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import msgspec

from pcmrs.dispatcher import Dispatcher, Workflow
from pcmrs.errors import ReplayError
from pcmrs.replay.differences import Difference
from pcmrs.replay.history import DaemonRun, closes_earlier_run
from pcmrs.service.restart.state import Kept, Ledger
from pcmrs.workflows.cell import Cell
from pcmrs.workflows.data import PlacementData


class Heritage:
    """Follows the runs in order.

    Attributes:
        kept: What the next run begins with.
    """

    def __init__(self) -> None:
        self.kept = Kept()

    def begin(self, run: DaemonRun, workflow: Workflow[Cell, PlacementData]) -> Iterator[Difference]:
        """Closes what the run before has begun: where this run has not done so, or closed something else.

        Args:
            run: That begins.
            workflow: That it was decided under.
        """
        closed = {
            (each.row.source or "", each.row.command_id or ""): each for each in run.rows if closes_earlier_run(each)
        }
        begun = {(each.source, each.command): each for each in self.kept.begun}
        for asked in begun.keys() - closed.keys():
            name = f"outcome {begun[asked].branch}.{begun[asked].operation}"
            yield Difference(sequence=run.rows[0].sequence, row=name, what="row", decided="unknown")
        for asked in closed.keys() - begun.keys():
            row = closed[asked].row
            name = f"outcome {row.branch}.{row.operation}"
            yield Difference(sequence=closed[asked].sequence, row=name, what="row", recorded="unknown")
        ledger = Ledger(workflow.blueprint, self.kept)
        started = [each for each in run.rows if each.row.kind == "config"][:1]
        for stored in (*started, *closed.values()):
            ledger.take(stored.row)
        self.kept = ledger.kept

    def give_to(self, dispatcher: Dispatcher[Cell, PlacementData], run: DaemonRun) -> None:
        """Has the dispatcher begin with it, as daemons do that write down how they begin."""
        if run.settings is not None:
            start = run.rows[0].sequence
            dispatcher.take_up(latched=self.kept.latched, unknown=self.kept.unknown, start=start)

    def inherited(self, workflow: Workflow[Cell, PlacementData]) -> Workflow[Cell, PlacementData]:
        """The workflow with the data that a run begins with.

        Raises:
            ReplayError: What an earlier run has left is not of the types that this program knows.
        """
        initial = workflow.initial
        kinds = {each.name: each.type for each in msgspec.structs.fields(type(initial))}
        try:
            kept = {name: msgspec.convert(value, kinds[name]) for name, value in self.kept.taken_back.items()}
        except msgspec.ValidationError as error:
            text = f"The journal holds registrations that this program cannot read: {error}."
            raise ReplayError(text) from None
        return replace(workflow, initial=msgspec.structs.replace(initial, **kept))

    def end(self, run: DaemonRun, workflow: Workflow[Cell, PlacementData]) -> None:
        """Takes in what a run leaves."""
        ledger = Ledger(workflow.blueprint, self.kept)
        for stored in run.decided():
            ledger.take(stored.row)
        self.kept = ledger.kept
