"""Measured runs: read a log, repair it, smooth its track, and cut it into 1 m segments."""
