"""What was measured: entities, scenes, data sets, and the files they come from."""
