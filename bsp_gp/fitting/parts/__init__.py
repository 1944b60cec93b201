"""Parts of hypotheses beyond the forces of a law, one short file each."""
