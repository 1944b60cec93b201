"""Tables in ZIP archives."""

import zipfile

import pandas as pd
import pytest

from bsp_gp import load_dataset
from bsp_gp.data import zipped
from bsp_gp.errors import DataError

ROWS = "t,x,y\n" + "".join(f"{0.1 * k:.1f},{k * k},{3 * k}\n" for k in range(12))


def archive(path, files):
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as out:
        for name, text in files.items():
            out.writestr(name, text)
    return path


@pytest.mark.parametrize("name", ["export.zip", "renamed.CSV"])
def test_one_table_beside_what_is_known_of_the_device_is_read(tmp_path, name):
    beside = {"meta/device.csv": "a,b\n1,2\n", "readme.txt": "hi"}
    path = archive(tmp_path / name, {"Data.csv": ROWS, **beside})
    data = load_dataset(path, units={"length": "m", "time": "s"})
    assert (data.scenes[0].name, len(data.scenes[0].times)) == (path.stem, 12)
    (note,) = [note for note in data.notes if "ZIP archive" in note]
    assert "'Data.csv' in it is read" in note and "'meta/device.csv'" in note


def test_line_ends_and_encodings_of_what_is_in_it_do_not_matter(tmp_path):
    text = ROWS.replace("y", "Höhe").replace("\n", "\r\n").encode("cp1252")
    data = load_dataset(archive(tmp_path / "a.zip", {"Messung.csv": text}))
    assert len(data.scenes[0].times) == 12
    assert any("Messung.csv is not UTF-8" in note for note in data.notes)


def test_several_tables_are_listed(tmp_path):
    path = archive(tmp_path / "a.zip", {"one.csv": ROWS, "two.csv": ROWS})
    with pytest.raises(DataError, match="2 tables: 'one.csv', 'two.csv'; unpack it"):
        load_dataset(path)


def test_an_archive_without_a_table_says_what_it_holds(tmp_path):
    with pytest.raises(DataError, match="without a table in it; it holds 'film.avi'; unpack"):
        load_dataset(archive(tmp_path / "a.zip", {"film.avi": "0"}))


def test_paths_are_ignored_and_sizes_are_bounded(tmp_path, monkeypatch):
    path = archive(tmp_path / "a.zip", {"../../up.csv": ROWS})
    assert ".." in zipfile.ZipFile(path).namelist()[0]
    assert len(load_dataset(path).scenes) == 1
    assert [each.name for each in tmp_path.iterdir()] == ["a.zip"]
    monkeypatch.setattr(zipped, "MAX_UNPACKED", 50)
    with pytest.raises(DataError, match="has more than 0 MB; unpack"):
        load_dataset(path)


def test_archives_in_archives_and_damaged_ones_are_refused(tmp_path):
    inner = archive(tmp_path / "inner.zip", {"a.csv": ROWS}).read_bytes()
    with pytest.raises(DataError, match="it is a ZIP archive itself"):
        load_dataset(archive(tmp_path / "a.zip", {"b.csv": inner}))
    path = archive(tmp_path / "b.zip", {"a.csv": ROWS})
    content = bytearray(path.read_bytes())
    content[45:60] = b"\x00" * 15
    path.write_bytes(content)
    with pytest.raises(DataError, match="cannot be unpacked"):
        load_dataset(path)


def test_a_complaint_names_the_table_in_the_archive(tmp_path):
    path = archive(tmp_path / "a.zip", {"a.csv": "\n"})
    with pytest.raises(DataError, match=r"a.zip, a.csv in it: the file is empty"):
        load_dataset(path)


def test_a_workbook_of_another_name_is_read(tmp_path):
    pytest.importorskip("openpyxl")
    path = tmp_path / "book.csv"
    with path.open("wb") as out:
        frame = pd.DataFrame({"t": [0.0, 0.1, 0.2, 0.3], "x": [0.0, 1, 2, 3], "y": 0.0})
        frame.to_excel(out, index=False, engine="openpyxl")
    assert len(load_dataset(path).scenes[0].times) == 4
