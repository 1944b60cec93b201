"""Closing the loop: residuals, the effects behind them, and when to stop."""
