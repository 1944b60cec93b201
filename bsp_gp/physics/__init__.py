"""What a law predicts: geometry, forces, dynamics, likelihoods, error metrics."""
