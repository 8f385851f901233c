"""Random sites, robots, drives and true energies for validation, without a formula of `model.loop` or `model.field`."""
