"""The page as a PDF file, laid out from the same HTML."""

from __future__ import annotations

import datetime
import io
from pathlib import Path
from typing import Final

__all__ = ["render_pdf"]

FACES: Final = (
    ("DejaVu Sans", "normal", "DejaVuSans.ttf"),
    ("DejaVu Sans", "bold", "DejaVuSans-Bold.ttf"),
    ("DejaVu Sans Mono", "normal", "DejaVuSansMono.ttf"),
)
"""Family, weight and file of each font."""


def render_pdf(page: str, wall: float) -> bytes:
    """Return the page as PDF on A4; only its fonts are loaded.

    The fonts are those of matplotlib; the machine's own ones are used only for letters that these lack.

    Args:
        page: Page from `render_page`.
        wall: Creation time in the file, Unix seconds: that of the session, so that the same session gives the same
            bytes.
    """
    import matplotlib as mpl
    import plutoprint

    fonts = Path(mpl.get_data_path()) / "fonts" / "ttf"
    letters = {(fonts / name).as_uri(): fonts / name for _, _, name in FACES}

    class Letters(plutoprint.ResourceFetcher):
        """Fetcher that allows the fonts only."""

        def fetch_url(self, url: str) -> plutoprint.ResourceData:
            return plutoprint.ResourceData(letters[url].read_bytes(), "font/ttf")

    faces = "".join(
        f"@font-face {{ font-family: '{family}'; font-weight: {weight}; src: url('{url}'); }}\n"
        for (family, weight, _), url in zip(FACES, letters, strict=True)
    )
    book = plutoprint.Book(plutoprint.PAGE_SIZE_A4, media=plutoprint.MEDIA_TYPE_PRINT)
    book.custom_resource_fetcher = Letters()
    book.load_html(page, user_style=f"{faces} body {{ font-family: '{FACES[0][0]}' !important; }}")
    made = datetime.datetime.fromtimestamp(wall, datetime.UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
    for field in (plutoprint.PDF_METADATA_CREATION_DATE, plutoprint.PDF_METADATA_MODIFICATION_DATE):
        book.set_metadata(field, made)
    written = io.BytesIO()
    book.write_to_pdf_stream(written)
    return written.getvalue()
