"""What is drawn of maps, routes and runs."""
