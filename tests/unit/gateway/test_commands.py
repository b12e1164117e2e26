"""Groups of commands that a peer may be allowed."""

from __future__ import annotations

from pcmrs.gateway.commands import COMMANDS, DEFAULT, GROUPS, STOP, allowed


def test_every_command_but_stop_is_in_one_group() -> None:
    grouped = [name for group in GROUPS.values() for name in group]
    assert sorted([*grouped, STOP]) == sorted(COMMANDS)


def test_whatever_drives_the_robot_is_in_no_group_of_the_default() -> None:
    for name in allowed(DEFAULT):
        assert all(step.branch not in ("placement", "robot") for step in COMMANDS[name].steps), name
        assert all(f"{step.branch}.{step.operation}" != "mapping.perform" for step in COMMANDS[name].steps), name
    assert {name for name, spec in COMMANDS.items() if any(step.branch == "placement" for step in spec.steps)} == set(
        GROUPS["motion"]
    )


def test_commands_may_be_listed_and_stop_is_always_allowed() -> None:
    assert allowed(["execute_homexxxx"]) == {"execute_homexxxx", STOP}
    assert allowed([]) == {STOP}
