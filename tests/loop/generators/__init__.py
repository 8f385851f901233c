"""Random sites, robots, drives and true energies for validation; nothing here comes from `model.loop` or `model.field`."""
