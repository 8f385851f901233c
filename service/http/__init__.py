"""The HTTP service: the app, its routes, and what happens to a request before and after them."""
