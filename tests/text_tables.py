"""Small tables as text files."""


def written(tmp_path, lines, name="track.csv"):
    """The path of a file with these lines."""
    path = tmp_path / name
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def rows(*columns, mark=","):
    """Lines of columns, a mark between their cells."""
    return [mark.join(map(str, row)) for row in zip(*columns, strict=True)]
