"""The approval of a drafted workflow: whose signature counts, for what, and where."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import pytest

from pcmrs.bus import Credentials
from pcmrs.errors import ConfigurationError
from pcmrs.fsm import Blueprint
from pcmrs.fsm.blueprint import MigrationSpec
from pcmrs.pki import Approval, Authority, approval_file, approve, read_approval, read_credentials
from tests.unit.authoring.design.step_tables import blueprint_of, step, table

ORIGIN = {"model": "made", "prompt": "ab", "protocol": "cd", "date": "2026-11-27"}
DRAFTED = blueprint_of(table(step("a"), provenance=ORIGIN))
DAY = 86400.0


class Lab:
    """An authority with a daemon and some people, and a drafted workflow.

    Attributes:
        file: File of the workflow.
        daemon: Identity of the daemon.
    """

    def __init__(self, authority: Authority, folder: Path, now: float) -> None:
        self.authority, self.folder, self.now = authority, folder, now
        self.file = folder / "drafted.toml"
        authority.issue("daemon", "cell", now, cells=["lab/c1"], into=folder)
        self.daemon = read_credentials(folder / "cell", now)

    def person(self, name: str, role: Any = "operator", cell: str = "lab/c1") -> Credentials:
        self.authority.issue(role, name, self.now, cells=[cell], into=self.folder)
        return read_credentials(self.folder / name, self.now)

    def sign(self, own: Credentials, blueprint: Blueprint = DRAFTED, **changes: Any) -> None:
        """Write the approval of a person, changed after it was signed."""
        approval = msgspec.structs.replace(approve(blueprint, own, self.now), **changes)
        approval_file(self.file).write_bytes(msgspec.json.encode(approval))

    def read(self, blueprint: Blueprint = DRAFTED, later: float = 0.0) -> Approval | None:
        members = self.authority.identities()
        return read_approval(blueprint, self.file, self.daemon, members, "lab/c1", self.now + later)


@pytest.fixture
def lab(authority: Authority, tmp_path: Path, now: float) -> Lab:
    return Lab(authority, tmp_path, now)


def test_the_approval_of_an_operator_counts(lab: Lab) -> None:
    lab.sign(lab.person("anna"))
    approval = lab.read()
    assert approval is not None
    assert (approval.by, approval.hash, approval.at) == ("anna", DRAFTED.hash, lab.now)


def test_a_person_whose_identity_has_ended_approves_nothing(lab: Lab) -> None:
    lab.sign(lab.person("anna"))
    (anna,) = (each for each in lab.authority.identities() if each.name == "anna")
    with pytest.raises(ConfigurationError, match="anna is not in the register as a valid operator"):
        lab.read(later=anna.ends - lab.now)


def test_a_newer_certificate_ends_what_the_older_one_signed(lab: Lab) -> None:
    """The older key may have been stolen, and the time in an approval is the signer's word."""
    lab.sign(lab.person("anna"))
    newer = lab.person("anna")
    with pytest.raises(ConfigurationError, match="anna signed with an older certificate"):
        lab.read()
    lab.sign(newer)
    assert lab.read() is not None


def test_a_migration_that_was_added_later_is_refused(lab: Lab) -> None:
    lab.sign(lab.person("anna"))
    older = MigrationSpec(version="0.0.1", hash="ab" * 32, why="only texts changed")
    changed = msgspec.structs.replace(DRAFTED, migrations=[older])
    assert changed.hash == DRAFTED.hash
    with pytest.raises(ConfigurationError, match="changed after it was approved"):
        lab.read(changed)


def test_a_workflow_of_people_needs_no_approval(lab: Lab) -> None:
    assert read_approval(blueprint_of(table(step("a"))), lab.file, None, (), "lab/c1", lab.now) is None


def test_without_an_approval_a_draft_is_refused(lab: Lab) -> None:
    with pytest.raises(ConfigurationError, match=r"nobody has approved it.*pcmrs fsm approve") as raised:
        lab.read()
    assert raised.value.fields == {"file": str(lab.file), "hash": DRAFTED.hash}


def test_a_changed_draft_is_refused(lab: Lab) -> None:
    lab.sign(lab.person("anna"))
    changed = blueprint_of(table(step("a"), step("b"), provenance=ORIGIN))
    with pytest.raises(ConfigurationError, match="changed after it was approved"):
        lab.read(changed)


def test_a_cell_without_identity_refuses_every_draft(lab: Lab) -> None:
    lab.sign(lab.person("anna"))
    with pytest.raises(ConfigurationError, match=r"access\.identity"):
        read_approval(DRAFTED, lab.file, None, (), "lab/c1", lab.now)


@pytest.mark.parametrize(("role", "cell"), [("viewer", "lab/c1"), ("planner", "lab/c1"), ("operator", "lab/c2")])
def test_only_operators_of_the_cell_may_approve(lab: Lab, role: str, cell: str) -> None:
    lab.sign(lab.person("anna", role, cell))
    with pytest.raises(ConfigurationError, match="anna is not in the register as a valid operator of lab/c1"):
        lab.read()


def test_a_revoked_person_has_approved_nothing(lab: Lab) -> None:
    lab.sign(lab.person("anna"))
    lab.authority.revoke("anna", lab.now)
    with pytest.raises(ConfigurationError, match="anna is not in the register"):
        lab.read()


@pytest.mark.parametrize(
    "forge",
    [
        lambda lab: lab.sign(lab.person("anna"), hash=DRAFTED.hash, id="other"),
        lambda lab: lab.sign(lab.person("anna"), blueprint_of(table(step("b"), provenance=ORIGIN)), hash=DRAFTED.hash),
        lambda lab: lab.sign(lab.person("anna"), at=lab.now + 1.0),
        lambda lab: lab.sign(lab.person("anna"), signature="AAAA"),
        lambda lab: lab.sign(lab.person("anna"), signature="no base64"),
        lambda lab: lab.sign(lab.person("anna"), certificate="no certificate"),
        lambda lab: lab.sign(lab.person("bob"), by=lab.person("anna").name),
        lambda lab: lab.sign(_of_another_lab(lab)),
        lambda lab: _late(lab),
    ],
)
def test_a_signature_that_is_not_the_persons_is_refused(lab: Lab, forge: Callable[[Lab], None]) -> None:
    forge(lab)
    with pytest.raises(ConfigurationError, match="is not that of anna"):
        lab.read()


def _of_another_lab(lab: Lab) -> Credentials:
    lab.person("anna")
    foreign = Authority.init(lab.folder / "foreign", "lab", lab.now)
    foreign.issue("operator", "anna", lab.now, cells=["lab/c1"], into=lab.folder / "other")
    return read_credentials(lab.folder / "other" / "anna", lab.now)


def _late(lab: Lab) -> None:
    """Sign with a certificate that had expired by then."""
    approval = approve(DRAFTED, lab.person("anna"), lab.now + 31 * DAY)
    approval_file(lab.file).write_bytes(msgspec.json.encode(approval))


@pytest.mark.parametrize("content", [b"", b"{}", b"[]", b"\xff", b'{"id": "x", "more": 1}'])
def test_a_file_that_is_no_approval_is_refused(lab: Lab, content: bytes) -> None:
    approval_file(lab.file).write_bytes(content)
    with pytest.raises(ConfigurationError, match="cannot be read"):
        lab.read()
