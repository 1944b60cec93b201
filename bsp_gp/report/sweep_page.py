"""The page of a sweep: what was found how often, and a row for every data set."""

from collections import Counter

from jinja2 import Environment, PackageLoader, StrictUndefined

from bsp_gp.report.numbers import format_number, is_number

MOST_KINDS = 20
"""Effects that are counted one by one."""


def sweep_page(rows, declared):
    """Write the page, a complete HTML document, every word escaped."""
    environment = Environment(
        loader=PackageLoader("bsp_gp.report"), autoescape=True, undefined=StrictUndefined,
        trim_blocks=True,
    )  # fmt: skip
    verdicts = Counter(row["verdict"] or "no verdict" for row in rows)
    found = Counter(row["effect"] for row in rows if row["effect"]).most_common(MOST_KINDS)
    groups = [("Verdict", verdicts.most_common())] + ([("Found", found)] if found else [])
    return environment.get_template("sweep.html").render(
        n=len(rows), declared=declared, groups=groups, rows=[_told(row) for row in rows]
    )


def _told(row):
    numbers = ("probability", "before", "after", "ratio")
    told = {name: format_number(row[name]) if is_number(row[name]) else "" for name in numbers}
    return {**row, **told, "error": row["error"].splitlines()[-1] if row["error"] else ""}
