"""What is kept in the data directory: a database, and files beside it."""
