"""The page of ``bsp-gp serve``: drop a file, declare, run, read, download."""
