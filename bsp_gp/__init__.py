"""Measured motion in; a force law in symbols, with units and error bars, out."""
