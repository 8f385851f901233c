"""Measured runs held against a model: residuals, the calibration that comes of them, and its report."""
