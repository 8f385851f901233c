"""Hostile files and generated inputs against the readers and the service: `python -m tests.fuzz`."""
