"""Predictors of the energy of a segment: published physics, the paper's network, the dense network."""
