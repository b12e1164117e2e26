"""Local certificate authority for the identities of the cells of one lab."""

from pcmrs.pki._approval import APPROVING, Approval, approval_file, approve, read_approval
from pcmrs.pki._authority import Authority, Issued
from pcmrs.pki._credentials import check_registered, read_credentials
from pcmrs.pki._register import read_register

__all__ = [
    "APPROVING",
    "Approval",
    "Authority",
    "Issued",
    "approval_file",
    "approve",
    "check_registered",
    "read_approval",
    "read_credentials",
    "read_register",
]
