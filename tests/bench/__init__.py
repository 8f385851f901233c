"""Measurements, not assertions: `make bench`."""
