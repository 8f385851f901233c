"""Calibration of a model with measured runs: the calibrated model, the report, and what to drive next."""
