"""How a hypothesis fits: its parts, its whole tracks, and whether the result is a fit."""
