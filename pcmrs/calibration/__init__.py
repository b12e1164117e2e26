"""Calibration files: versioned, dated and hashed."""
