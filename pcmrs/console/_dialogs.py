"""The open dialogs of one page, which the server closes: a browser that closed them itself could swallow a Stop."""

from __future__ import annotations

from typing import Any

from nicegui import ui


class Dialogs:
    """Stack of open dialogs; the newest is on top."""

    def __init__(self) -> None:
        self._open: list[ui.dialog] = []

    def __bool__(self) -> bool:
        return bool(self._open)

    async def ask(self, dialog: ui.dialog) -> Any:
        """Open a dialog, and return what is submitted in it; None if it is closed. It is deleted then.

        Args:
            dialog: The dialog, which nobody has opened yet.
        """
        dialog.props("no-esc-dismiss")
        self._open.append(dialog)
        try:
            return await dialog
        finally:
            self._open.remove(dialog)
            dialog.delete()

    def close_newest(self) -> None:
        """Close the dialog on top, as its button to cancel does."""
        if self._open:
            self._open[-1].submit(None)
