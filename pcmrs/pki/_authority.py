"""The certificate authority of a lab: a folder with its key, its certificate, and the register of identities."""

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
from pcmrs.messages.identity import INFRASTRUCTURE, PEOPLE, ROLES, Identity, Role, check_cells, check_name
from pcmrs.pki._certificates import CLOCKS_DIFFER, authority_certificate, certificate, key_bytes, new_key, read_key
from pcmrs.pki._register import read_register

KEY: Final = "ca.key"
CERTIFICATE: Final = "ca.pem"
REGISTER: Final = "register.json"
DAYS: Final = 30.0
"""Default validity of a certificate, days."""
MOST_DAYS: Final = 398.0


class Issued(msgspec.Struct, frozen=True, kw_only=True):
    """A new certificate and its files.

    Attributes:
        identity: Identity that it certifies.
        folder: Folder of ``<name>.pem``, ``<name>.key`` and ``ca.pem``, which the machine that uses it needs.
    """

    identity: Identity
    folder: str


class Authority:
    """An existing authority; create one with `Authority.init`.

    Args:
        folder: Folder of the authority, readable by its owner only.

    Raises:
        ConfigurationError: The folder holds no authority.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        if not (folder / CERTIFICATE).is_file():
            raise ConfigurationError(
                f"There is no authority in {folder}: `pcmrs pki init` creates one.", path=str(folder)
            )

    @classmethod
    def init(cls, folder: Path, site: str, now: float) -> Authority:
        """Create an authority.

        Args:
            folder: Folder of the authority; it is created if it does not exist, and must hold no authority yet.
            site: Name of the lab.
            now: Wall time, Unix seconds.

        Raises:
            ConfigurationError: There is one already, or the name of the lab is not allowed.
            OSError: The folder cannot be written.
        """
        check_name(site)
        if (folder / KEY).exists() or (folder / CERTIFICATE).exists():
            text = f"There is an authority in {folder} already: all certificates that it issued would become invalid."
            raise ConfigurationError(text, path=str(folder))
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        key = new_key()
        write_durably(folder / KEY, key_bytes(key), mode=SECRET)
        write_durably(folder / REGISTER, b"[]\n", mode=0o644)
        own = authority_certificate(key, site, now - CLOCKS_DIFFER).public_bytes(Encoding.PEM)
        write_durably(folder / CERTIFICATE, own, mode=0o644)
        return cls(folder)

    def identities(self) -> list[Identity]:
        """Return all identities that have a certificate, in the order of their issue.

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
        cells: Sequence[str],
        via: Sequence[str] = (),
        into: Path,
    ) -> Issued:
        """Issue a certificate with a new key; an existing name with the same role gets a newer one.

        Args:
            role: Role of the identity.
            name: Name of the identity; not a revoked one, whose earlier certificate would become valid again.
            now: Wall time, Unix seconds.
            days: Validity, days.
            hosts: Hosts at which others connect to it: required for a router, optional for a daemon, none for others.
            cells: Cells in which the role applies, as ``<site>/<cell>``.
            via: Names of the routers that may forward the messages of a person.
            into: Folder in which the folder `name` with the files is created.

        Raises:
            ConfigurationError: Name, role, days, hosts, cells or routers are not allowed, or others may read the key
                of the authority.
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
            # The register first: a certificate that is not in it could not be revoked.
            self._write([*(each for each in known if each.name != name), identity])
        folder = into / name
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        write_durably(folder / f"{name}.key", key_bytes(key), mode=SECRET)
        write_durably(folder / f"{name}.pem", signed.public_bytes(Encoding.PEM), mode=0o644)
        write_durably(folder / CERTIFICATE, (self.folder / CERTIFICATE).read_bytes(), mode=0o644)
        return Issued(identity=identity, folder=str(folder))

    def revoke(self, name: str, now: float) -> Identity:
        """Revoke an identity for good, and return it.

        Args:
            name: Name of the identity.
            now: Wall time, Unix seconds.

        Raises:
            ConfigurationError: There is no such identity, or it is revoked already.
        """
        with self._register() as known:
            found = next((each for each in known if each.name == name), None)
            if found is None or found.revoked is not None:
                why = "there is no such identity" if found is None else "it is revoked already"
                raise ConfigurationError(f"{name} cannot be revoked: {why}; see `pcmrs pki list`.", name=name)
            revoked = msgspec.structs.replace(found, revoked=now)
            self._write([revoked if each is found else each for each in known])
        return revoked

    def _check(self, role: Role, name: str, days: float, hosts: Sequence[str], via: Sequence[str]) -> None:
        check_name(name)
        if role not in ROLES:
            raise ConfigurationError(f"{role!r} is not a role; choose {', '.join(ROLES)}.", role=role)
        if not 0.0 < days <= MOST_DAYS:
            text = f"A certificate is valid for more than 0 days and {MOST_DAYS:g} at most, not {days:g}."
            raise ConfigurationError(text, days=days, limit=MOST_DAYS)
        if hosts and role not in INFRASTRUCTURE:
            raise ConfigurationError(f"A {role} accepts no connections: give no hosts.", role=role, hosts=list(hosts))
        if via and role not in PEOPLE:
            raise ConfigurationError(f"Routers forward messages of people, not of a {role}.", role=role, via=list(via))
        if role == "router" and not hosts:
            raise ConfigurationError("A router accepts connections: give its hosts.", role=role)

    @contextmanager
    def _register(self) -> Iterator[list[Identity]]:
        """Lock the register and yield it."""
        with (self.folder / f"{REGISTER}.lock").open("w") as lock:
            import fcntl  # not on Windows, where identities can be read but not issued

            fcntl.flock(lock, fcntl.LOCK_EX)
            yield self.identities()

    def _write(self, known: Sequence[Identity]) -> None:
        content = msgspec.json.format(msgspec.json.encode(known), indent=2) + b"\n"
        write_durably(self.folder / REGISTER, content, mode=0o644)


def _refuse(role: Role, name: str, known: Sequence[Identity]) -> None:
    for each in known:
        if each.name == name and each.revoked is not None:
            text = (
                f"{name} was revoked: its certificate would become valid again. Choose another name, such as {name}2."
            )
            raise ConfigurationError(text, name=name)
        if each.name == name and each.role != role:
            text = f"{name} has the role {each.role} already: choose another name for the {role}."
            raise ConfigurationError(text, name=name, role=each.role)
