"""The paper's experiments on simulated sites, beside the baselines and the floors: what `joulemap reproduce` runs."""
