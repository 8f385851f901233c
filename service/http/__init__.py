"""The HTTP service: the app, its routes, and what a request passes on its way in and out."""
