"""The paper's experiments on simulated sites, beside the baselines and the floors: `python -m tests.paper`."""
