"""The next experiment: what would part the rivals, and the loop closed by running it."""
