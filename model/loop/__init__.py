"""The calibration loop: what the residuals of measured runs say about a model, and the calibrated model made of it."""
