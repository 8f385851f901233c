"""Files for other programs: routes and whole cost maps. A format is a module here and a line in a registry."""
