"""Which masses: posteriors of the latents, and EM over laws and latents."""
