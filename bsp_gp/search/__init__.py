"""The M-step: which law. Strategies share one objective and one notion of a candidate."""
