"""From video to trajectories and back."""
