"""The page as PDF: the same bytes each time, wherever the journal lies."""

from __future__ import annotations

import shutil
from pathlib import Path

from tests.unit.report.report_journals import golden_rows, write_journal
from tests.unit.report.report_page import run


def test_page_and_pdf_are_reproducible_wherever_the_journal_lies(tmp_path: Path) -> None:
    journal = write_journal(golden_rows("ratms_threshold"), tmp_path / "cell" / "ratms_threshold.sqlite")
    shutil.copytree(journal.parent, tmp_path / "copy")
    written = []
    for source in (journal, tmp_path / "copy"):
        assert run(source, "-o", tmp_path / "a.html", "--pdf", tmp_path / "a.pdf")[0] == 0
        written.append([(tmp_path / name).read_bytes() for name in ("a.html", "a.pdf")])
    assert written[0] == written[1]
    html, pdf = written[0]
    assert pdf.startswith(b"%PDF-")
    assert pdf.rstrip().endswith(b"%%EOF")
    assert str(tmp_path).encode() not in html + pdf
