"""A drive while it lasts: what is known of the route, what the log says, and what follows for the rest."""
