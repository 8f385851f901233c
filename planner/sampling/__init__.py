"""OMPL's sampling planners on the same prices and limits."""
