"""Jobs that take a while: how each kind is sent off to the engine, and what becomes of it."""
