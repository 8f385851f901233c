"""Slow, obvious yardsticks for the tests."""
