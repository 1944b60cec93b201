"""How results reach the disk: whole or not at all, and never in the place of what is not ours."""
