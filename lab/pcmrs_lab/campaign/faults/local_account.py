"""Files that an account on the cell's machine can read, and names that a configured account may have."""

from __future__ import annotations

import asyncio
from pathlib import Path

from pcmrs.gateway.signing import new_key
from pcmrs.testing.driving import accept
from pcmrs_lab.campaign.checks import expect
from pcmrs_lab.campaign.fault import Evidence, fault
from pcmrs_lab.campaign.lab import Lab
from pcmrs_lab.campaign.reachable import People
from pcmrs_lab.campaign.sham import is_sham
from pcmrs_lab.campaign.tries import FILES, LOCAL_ACCOUNT, record
from pcmrs_lab.campaign.without_guard import without_guards

OTHERS = 0o077
"""Mode bits that permit something to others than the owner."""


@fault(
    "A30",
    how="a daemon that is started by hand in an open folder, by a shell that lets everybody read new files",
    tries={LOCAL_ACCOUNT: ["journal", FILES]},
)
async def open_folder(lab: Lab) -> Evidence:
    """Only the owner may read the daemon's files; files that the same shell writes itself, everybody may read."""
    folder, probe = lab.folder / "open", lab.folder / "probe"
    opened = await asyncio.to_thread(_make_open, folder)
    umask = "077" if is_sham() else "022"
    shell = ("sh", "-c", f'umask {umask}; : > "{probe}"; exec "$@"', "sh")
    async with lab.daemon(folder=folder, prefix=shell) as cell:
        await accept(cell.client, "registration.reinit")
        modes = await asyncio.to_thread(_modes, folder, Path(cell.ready.journal), probe)
    record(LOCAL_ACCOUNT, "journal", FILES)
    probed = modes.pop(probe.name)
    expect(probed & OTHERS == 0o044, "The shell did not let others read new files.")
    expect(len(modes) > 4, f"Only {', '.join(modes)} were checked.")
    shared = {name: f"{mode:04o}" for name, mode in modes.items() if mode & OTHERS}
    expect(not shared, f"Others may use {shared}.")
    unguarded = (*shell, *without_guards("others_may_read_what_the_daemon_writes"))
    async with lab.daemon(folder=_open_beside(folder), prefix=unguarded) as other:
        await accept(other.client, "registration.reinit")
        readable = await asyncio.to_thread(_modes, other.folder, Path(other.ready.journal), probe)
    readable.pop(probe.name)
    readable.pop(other.folder.name)
    exposed = {name: f"{mode:04o}" for name, mode in readable.items() if mode & OTHERS}
    return Evidence(
        "readable by its owner only",
        took_place={"mode_of_the_folder_before": opened},
        control_kind="mutant",
        control={"others_may_read_without_the_guard": exposed, "mode_of_a_file_of_the_shell": f"{probed:04o}"},
        details={"files": sorted(modes)},
    )


def _open_beside(folder: Path) -> Path:
    beside = folder.with_name("unguarded")
    _make_open(beside)
    return beside


def _make_open(folder: Path) -> str:
    folder.mkdir()
    folder.chmod(0o700 if is_sham() else 0o755)
    return f"{folder.stat().st_mode & 0o777:04o}"


def _modes(folder: Path, journal: Path, probe: Path) -> dict[str, int]:
    """Return the modes of the folder, of journal and keys in it, and of the probe, by name."""
    files = (folder, probe, *folder.glob(f"{journal.name}*"), *folder.glob("journal.*"))
    return {path.name: path.stat().st_mode & 0o777 for path in files}


@fault(
    "A31",
    how="a peer in the configuration with the name of the operators on site, and with another name",
    tries={"peer": [FILES]},
)
async def peer_named_local(lab: Lab) -> Evidence:
    """The daemon refuses to start with the first, with the reason; with the second it starts."""
    key = lab.folder / "peer.key"
    new_key(key)
    name = "locals" if is_sham() else "local"
    status, errors = await lab.start_refused(f"gateway.peers.{name}.key_file={key}")
    text = errors.strip().splitlines()[-1] if errors.strip() else ""
    record("peer", FILES)
    expect(status != 0 and "local" in text and "Traceback" not in errors, f"It ended with {status}: {text}")
    async with lab.daemon(f"gateway.peers.locals.key_file={key}") as cell:
        control = await accept(cell.client, "registration.reinit")
    return Evidence(
        "refused to start, with the reason",
        took_place={"said_of_the_name": text},
        control_kind="permitted",
        control={"accepted_with_another_name": control.decision},
        details={"status": status},
    )


@fault(
    "A31",
    how="a peer in the configuration with the name of an operator in the register, and with another name",
    tries={"peer": [FILES]},
)
async def peer_named_as_a_member(lab: Lab) -> Evidence:
    """Their commands would count as those of one user, also for the lease: the daemon refuses to start."""
    people, key = People(lab.folder / "people", "lab/*"), lab.folder / "peer.key"
    new_key(key)
    access = (f"access.identity={people.folder / 'daemon1'}", f"access.register={people.register}")
    name = "another" if is_sham() else "anna"
    status, errors = await lab.start_refused(*access, f"gateway.peers.{name}.key_file={key}")
    text = errors.strip().splitlines()[-1] if errors.strip() else ""
    record("peer", FILES)
    expect(status != 0 and "'anna'" in text and "Traceback" not in errors, f"It ended with {status}: {text}")
    async with lab.daemon(*access, f"gateway.peers.another.key_file={key}") as cell:
        control = await accept(cell.client, "lease.acquire")
    return Evidence(
        "refused to start, with the reason",
        took_place={"said_of_the_name": text},
        control_kind="permitted",
        control={"accepted_with_another_name": control.decision},
        details={"status": status},
    )
