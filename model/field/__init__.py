"""Simulated reality: a robot, its ground and its logger. Shares no formula with `joulemap.model.energy`."""
