"""How a hypothesis fits: tracks, their derivatives, their noise, and what a fit says."""
