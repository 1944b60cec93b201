"""Parts that hypotheses are put together from, one short file for each kind."""
