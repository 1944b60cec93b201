"""How a hypothesis fits: tracks, their derivatives, the noise, and the one least-squares driver."""
