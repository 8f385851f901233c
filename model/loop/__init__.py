"""The calibration loop: measured runs, the segments cut from them, and what they say about the model."""
