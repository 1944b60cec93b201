"""Neural models of motion as the paper compares them, and a tuned version of each.

Needs the extra ``neural`` (jax, optax); ``bsp_gp`` never imports it.
"""
