"""Are the odds right? Intervals and probabilities of route energies beside what was measured, on runs left out."""
