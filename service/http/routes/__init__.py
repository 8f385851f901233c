"""The HTTP routes, one module per thing that is asked about."""
