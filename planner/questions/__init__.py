"""Further questions about ways: alternatives, tours, a lower bound, and a new plan for a robot on its way."""
