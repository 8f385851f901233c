"""Energy planner for ground robots."""
