"""Ways that are best in another sense than mean energy: with a probability to arrive, or within a limit of power."""
