"""Jobs that take a while: their steps in the database, the workers, and what a step of each kind does."""
