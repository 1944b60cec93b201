"""A first look at a file in a process of its own: headings and rows of a table, a film's frame.

``python -m bsp_gp.web.glimpse FILE OUT`` writes the picture OUT of a film's first frame, or JSON of
a table's columns to stdout.
"""

from __future__ import annotations

import csv
import json
import sys
from pathlib import Path

from bsp_gp.errors import BspError
from bsp_gp.web.store import FILMS

N_ROWS, N_LINES, N_COLUMNS = 5, 40, 60


def columns(path):
    """Columns of a table as they stand in the file, and as they are understood.

    Returns
    -------
    list of dict
        ``theirs``, ``ours`` (empty if it means nothing to us), ``unit``, ``rows``.
    """
    from bsp_gp.data.headings import UNKNOWN
    from bsp_gp.data.sniffing import sniff, split_line
    from bsp_gp.data.sources import open_source

    with open_source(path).open() as stream:
        head = [line.rstrip("\n") for _, line in zip(range(N_LINES), stream, strict=False)]
    layout = sniff(head, {}, ("t", "frame"), path)
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


def first_frame(path, out):
    """Write the first frame of a film as PNG, and return its size and rate."""
    from matplotlib.image import imsave

    from bsp_gp.vision.video import open_video

    video = open_video(path)
    image = next(iter(video.frames(0, 1)))[1]
    imsave(out, image[..., ::-1])  # BGR
    return {
        "width": image.shape[1], "height": image.shape[0], "fps": video.fps,
        "n_frames": video.n_frames,
    }  # fmt: skip


def main(argv):
    """Look, and say it as JSON; 2 and a line on stderr where there is nothing to see."""
    path, out = Path(argv[0]), Path(argv[1])
    try:
        if path.suffix.lower() in FILMS:
            found = first_frame(path, out)
        elif path.is_dir() or path.suffix.lower() in (".trk", ".parquet", ".pq"):
            found = []
        else:
            found = columns(path)
    except (BspError, OSError, csv.Error, UnicodeError) as error:
        sys.stderr.write(f"bsp-gp: error: {' '.join(str(error).split())}\n")
        return 2
    sys.stdout.write(json.dumps(found))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
