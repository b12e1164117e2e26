"""Names of people, as commands give them and records show them."""

from __future__ import annotations

from typing import Annotated

import msgspec

NAME = r"\A(?=.*\w)[^\x00-\x1f\x7f-\x9f\u2028\u2029\u202a-\u202e\u2066-\u2069]+\Z"
"""Something to read, and nothing that would write on another line or place of a record: no control characters."""

PersonName = Annotated[str, msgspec.Meta(max_length=100, pattern=NAME)]
