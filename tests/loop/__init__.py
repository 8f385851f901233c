"""Does a calibration find hidden effects? Validation on unseen cases over effects and seeds, and their table."""
