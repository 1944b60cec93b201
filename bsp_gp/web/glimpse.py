"""A first look at a file in a process of its own: headings and rows of a table, a film's frame.

``python -m bsp_gp.web.glimpse FILE OUT`` writes the picture OUT of a film's first frame, or JSON of
a table's columns to stdout.
"""

import csv
import json
import sys
from pathlib import Path

from bsp_gp.data.glance import columns_of
from bsp_gp.errors import BspError
from bsp_gp.web.store import FILMS


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
            found = columns_of(path)
    except (BspError, OSError, csv.Error, UnicodeError) as error:
        sys.stderr.write(f"bsp-gp: error: {' '.join(str(error).split())}\n")
        return 2
    sys.stdout.write(json.dumps(found))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
