"""Closing the loop: what is left, where it comes from, which law adds it, what that bought."""
