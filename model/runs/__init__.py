"""Measured runs: read a log, repair it, smooth its track, and cut it into segments of 1 m."""
