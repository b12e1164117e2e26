"""The certificate authority of a lab: a folder with its key, its certificate, and a register of who has one."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Final

import msgspec
from cryptography import x509
from cryptography.hazmat.primitives.serialization import Encoding

from pcmrs.errors import ConfigurationError
from pcmrs.files import SECRET, write_durably
from pcmrs.messages.identity import EVERY_CELL, INFRASTRUCTURE, PEOPLE, ROLES, Identity, Role, check_cells, check_name
from pcmrs.pki.certificates import CLOCKS_DIFFER, authority_certificate, certificate, key_bytes, new_key, read_key
from pcmrs.pki.register import read_register

KEY: Final = "ca.key"
CERTIFICATE: Final = "ca.pem"
REGISTER: Final = "register.json"
DAYS: Final = 30.0
"""Validity of a certificate unless another one is asked for."""
MOST_DAYS: Final = 398.0


class Issued(msgspec.Struct, frozen=True, kw_only=True):
    """A new certificate and where its files are.

    Attributes:
        identity: Whose it is.
        folder: Holds ``<name>.pem``, ``<name>.key`` and ``ca.pem``: what the machine that uses it needs.
    """

    identity: Identity
    folder: str


class Authority:
    """An authority that exists; make one with `Authority.init`.

    Args:
        folder: Its own; nobody but its owner may read it.

    Raises:
        ConfigurationError: There is none in the folder.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        if not (folder / CERTIFICATE).is_file():
            raise ConfigurationError(
                f"There is no authority in {folder}: `pcmrs pki init` makes one.", path=str(folder)
            )

    @classmethod
    def init(cls, folder: Path, site: str, now: float) -> Authority:
        """Make an authority.

        Args:
            folder: Made where it does not exist; it must hold no authority yet.
            site: Name of the lab.
            now: Wall time, s.

        Raises:
            ConfigurationError: There is one already, or the site's name cannot be one.
            OSError: The folder cannot be written.
        """
        check_name(site)
        if (folder / KEY).exists() or (folder / CERTIFICATE).exists():
            text = f"There is an authority in {folder} already: everything that it has issued would become worthless."
            raise ConfigurationError(text, path=str(folder))
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        key = new_key()
        write_durably(folder / KEY, key_bytes(key), mode=SECRET)
        write_durably(folder / REGISTER, b"[]\n", mode=0o644)
        own = authority_certificate(key, site, now - CLOCKS_DIFFER).public_bytes(Encoding.PEM)
        write_durably(folder / CERTIFICATE, own, mode=0o644)
        return cls(folder)

    def identities(self) -> list[Identity]:
        """Everybody who has been given a certificate, in the order in which that was.

        Raises:
            ConfigurationError: The register cannot be read.
        """
        return read_register(self.folder / REGISTER)

    def issue(
        self,
        role: Role,
        name: str,
        now: float,
        *,
        days: float = DAYS,
        hosts: Sequence[str] = (),
        cells: Sequence[str] = EVERY_CELL,
        via: Sequence[str] = (),
        into: Path,
    ) -> Issued:
        """Issue a certificate with a new key; a name that has one, and the same role, gets a newer one.

        Args:
            role: What it may do.
            name: Never one that was revoked: the certificate of before would be valid again.
            now: Wall time, s.
            days: Validity.
            hosts: Under which it is dialled; a router needs one, a daemon that is not dialled none, others have none.
            cells: In which it may do that, as ``<site>/<cell>``.
            via: Names of the routers that may carry what a person sends.
            into: Folder in which a folder `name` with the files is made.

        Raises:
            ConfigurationError: Name, role, days, hosts, cells or routers are wrong, or others may read the key of the
                authority.
            OSError: The files cannot be written.
        """
        self._check(role, name, days, hosts, via)
        key = new_key()
        with self._register() as known:
            _refuse(role, name, known)
            identity = Identity(
                name=name,
                role=role,
                serial=f"{x509.random_serial_number():x}",
                begins=now - CLOCKS_DIFFER,
                ends=now + days * 86400.0,
                cells=check_cells(cells),
                via=tuple(map(check_name, via)),
            )
            authority = x509.load_pem_x509_certificate((self.folder / CERTIFICATE).read_bytes())
            signed = certificate(identity, key.public_key(), hosts, authority, read_key(self.folder / KEY))
            # First the register: a certificate that it does not know could not be revoked.
            self._write([*(each for each in known if each.name != name), identity])
        folder = into / name
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        write_durably(folder / f"{name}.key", key_bytes(key), mode=SECRET)
        write_durably(folder / f"{name}.pem", signed.public_bytes(Encoding.PEM), mode=0o644)
        write_durably(folder / CERTIFICATE, (self.folder / CERTIFICATE).read_bytes(), mode=0o644)
        return Issued(identity=identity, folder=str(folder))

    def revoke(self, name: str, now: float) -> Identity:
        """Take an identity's rights away, for good; returns it.

        Raises:
            ConfigurationError: Nobody has this name, or it is revoked already.
        """
        with self._register() as known:
            found = next((each for each in known if each.name == name), None)
            if found is None or found.revoked is not None:
                why = "nobody has this name" if found is None else "it is revoked already"
                raise ConfigurationError(f"{name} cannot be revoked: {why}; see `pcmrs pki list`.", name=name)
            revoked = msgspec.structs.replace(found, revoked=now)
            self._write([revoked if each is found else each for each in known])
        return revoked

    def _check(self, role: Role, name: str, days: float, hosts: Sequence[str], via: Sequence[str]) -> None:
        check_name(name)
        if role not in ROLES:
            raise ConfigurationError(f"{role!r} is no role; choose {', '.join(ROLES)}.", role=role)
        if not 0.0 < days <= MOST_DAYS:
            text = f"A certificate is valid for more than 0 days and {MOST_DAYS:g} at most, not {days:g}."
            raise ConfigurationError(text, days=days, limit=MOST_DAYS)
        if hosts and role not in INFRASTRUCTURE:
            raise ConfigurationError(f"A {role} is not dialled: give no hosts.", role=role, hosts=list(hosts))
        if via and role not in PEOPLE:
            raise ConfigurationError(f"Routers carry what people send, nothing of a {role}.", role=role, via=list(via))
        if role == "router" and not hosts:
            raise ConfigurationError("A router is dialled: say at which hosts.", role=role)

    @contextmanager
    def _register(self) -> Iterator[list[Identity]]:
        """The register, while nobody else changes it."""
        with (self.folder / f"{REGISTER}.lock").open("w") as lock:
            import fcntl  # who only reads an identity does so on Windows, too

            fcntl.flock(lock, fcntl.LOCK_EX)
            yield self.identities()

    def _write(self, known: Sequence[Identity]) -> None:
        content = msgspec.json.format(msgspec.json.encode(known), indent=2) + b"\n"
        write_durably(self.folder / REGISTER, content, mode=0o644)


def _refuse(role: Role, name: str, known: Sequence[Identity]) -> None:
    for each in known:
        if each.name == name and each.revoked is not None:
            text = f"{name} was revoked, and its certificate would count again: choose another name, such as {name}2."
            raise ConfigurationError(text, name=name)
        if each.name == name and each.role != role:
            text = f"{name} has the role {each.role} already: choose another name for the {role}."
            raise ConfigurationError(text, name=name, role=each.role)
