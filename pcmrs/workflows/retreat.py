"""Arguments of the operations that bring the tool away from the body."""

from __future__ import annotations

import msgspec


class Retreat(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Arguments of `back_off`, `home` and `to_initial`.

    Attributes:
        confirm: Somebody has looked at the whole way; it is needed where no registration tells where the body is.
    """

    confirm: bool = False
