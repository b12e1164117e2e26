"""The report of a session, as HTML and as PDF: one page for a clinician, then the details."""
