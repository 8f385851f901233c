"""Models made from runs, measured or simulated: training, the shipped network, distillation, evaluation."""
