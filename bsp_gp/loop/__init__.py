"""Closing the loop: what a declared law lacks is found, named, added, and judged."""
