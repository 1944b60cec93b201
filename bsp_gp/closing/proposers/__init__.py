"""Proposers: each turns a fit into causes that may be missing, one short file each."""
