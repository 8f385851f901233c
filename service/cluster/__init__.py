"""The Dask cluster that does the work: its address, the connection to it, and whether its workers are there."""
