"""Who may take part: a local certificate authority for the cells of one lab."""

from pcmrs.pki.authority import Authority, Issued
from pcmrs.pki.identity import Identity
from pcmrs.pki.keyfile import check_private

__all__ = ["Authority", "Identity", "Issued", "check_private"]
