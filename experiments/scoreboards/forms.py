"""The form of a law, as benchmarks ask for it: exponents rounded, constants free."""

from bsp_gp.fitting.starts import roles_of


def with_rounded_powers(law):
    """A law with its fitted exponents rounded to 0.1."""
    roles = roles_of(law)
    return law.with_constants(
        {n: round(v, 1) if roles[n] == "exponent" else v for n, v in law.constants.items()}
    )
