"""Grammar files of bsp_gp, one TOML each: data, not code."""
