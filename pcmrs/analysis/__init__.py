"""Analysis of placements, pose logs and sessions with stimulation: errors, tables and figures."""
