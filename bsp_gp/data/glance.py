"""A first look at a table: its columns as they stand there, and as they are understood."""

from bsp_gp.data.headings import UNKNOWN
from bsp_gp.data.sniffing import sniff, split_line
from bsp_gp.data.sources import open_source

N_ROWS, N_LINES, N_COLUMNS = 5, 40, 60


def columns_of(path, rename=None):
    """Columns of a table, at most 60, a list of dict.

    Of each ``theirs``, ``ours`` (empty if it means nothing to us), ``unit``, and ``rows``. `rename`
    maps our name of a column to its name in the file.
    """
    source = open_source(path)
    head = source.without_brackets(source.head(N_LINES)).head(N_LINES)
    layout = sniff(head, dict(rename or {}), ("t", "frame"), path)
    rows = [split_line(line, layout.delimiter) for line in head[layout.data_line :] if line.strip()]
    return [
        {
            "theirs": heading.theirs or heading.name,
            "ours": heading.name if heading.sure != UNKNOWN else "",
            "unit": unit or heading.unit,
            "rows": [row[k][:40] if k < len(row) else "" for row in rows[:N_ROWS]],
        }
        for k, (heading, unit) in enumerate(zip(layout.headings, layout.units, strict=True))
    ][:N_COLUMNS]
