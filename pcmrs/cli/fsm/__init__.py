"""`pcmrs fsm`: design, drafting, verification, drawing and tests of workflows."""

from __future__ import annotations

import click

from pcmrs.cli.lazy import LABORATORY, LazyCommand, LazyGroup

COMMANDS = {
    "design": LazyCommand(
        "pcmrs.cli.fsm.design:design",
        "Design a workflow from the critical operations in STEPS, a TOML file or - for standard input.",
    ),
    "draft": LazyCommand(
        "pcmrs.cli.fsm.draft:draft",
        "Draft the step table of a PROTOCOL, a text file or - for standard input, with a language model.",
    ),
    "approve": LazyCommand(
        "pcmrs.cli.fsm.approve:approve",
        "Sign the workflow FILE, which a language model has drafted, with your own key.",
    ),
    "verify": LazyCommand(
        "pcmrs.cli.fsm.verify:verify", "Search all joint states of each FILE for violations of a rule or a property."
    ),
    "generate": LazyCommand(
        "pcmrs.cli.fsm.generate:generate", "Print the Python source of the branch and state classes of FILE."
    ),
    "render": LazyCommand("pcmrs.cli.fsm.render:render", "Draw the state chart of FILE."),
    "export": LazyCommand("pcmrs.cli.fsm.export:export", "Write FILE for other tools."),
    "import": LazyCommand(
        "pcmrs.cli.fsm.import_:import_",
        "Make a blueprint of a state chart in SCXML, Mermaid stateDiagram-v2 or draw.io XML.",
    ),
    "simulate": LazyCommand(
        "pcmrs.cli.fsm.simulate:simulate",
        "Step through the workflow FILE: see all possible commands, and the effects of those you give.",
    ),
    "test": LazyCommand(
        LABORATORY, "Take the workflow FILE through every operation in every joint state, accepted and rejected."
    ),
    "diff": LazyCommand(
        "pcmrs.cli.fsm.diff:diff",
        "List the differences in behaviour of the workflows OLD and NEW: joint states, accepted operations, "
        "their targets.",
    ),
}


@click.group(cls=LazyGroup, commands=COMMANDS, prefix="fsm.")
def fsm() -> None:
    """Design, draft, verify, draw, import, test and compare workflows.

    FILE is a blueprint, the name of an installed workflow such as ratms, or - for standard input. Exit status:
    0 sound or done, 1 unsound or different, 5 unreadable or impossible.
    """
