"""Made-up worlds to test against."""
