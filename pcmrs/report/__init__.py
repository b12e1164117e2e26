"""Reports of sessions, read from their journals: as HTML and PDF, one page for a clinician, then the details."""
