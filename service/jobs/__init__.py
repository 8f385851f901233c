"""Jobs that take a while: their steps in the database, who does them, and what a step of each kind does."""
