"""Tables written as JSON, as recorders and web pages keep them."""

import json

import numpy as np
import pytest

from bsp_gp.data.records import as_table
from bsp_gp.data.tables import load_dataset
from bsp_gp.errors import DataError

TIMES = np.arange(5) * 0.1
RECORDS = [{"t": float(t), "entity": "ball", "x": float(t**2), "y": 1.0} for t in TIMES]
RECORDS[2] |= {"x": None, "y": None}  # not seen


@pytest.mark.parametrize("text, name", [
    ("\n".join(map(json.dumps, RECORDS)), "a.jsonl"), (json.dumps(RECORDS, indent=1), "a.json"),
    (json.dumps({"fps": 10, "rows": RECORDS}), "a.json"), (json.dumps(RECORDS), "a.txt"),
    (json.dumps({n: [r[n] for r in RECORDS] for n in RECORDS[0]}), "a.json"),
])  # fmt: skip
def test_records_in_all_their_ways_are_the_same_table(text, name, tmp_path):
    (tmp_path / name).write_text(text, encoding="utf-8")
    (scene,) = load_dataset(tmp_path / name).scenes
    seen = np.delete(TIMES, 2)
    assert scene.names == ("ball",) and np.array_equal(scene.times, seen)
    assert np.array_equal(scene.positions[:, 0], np.stack([seen**2, np.ones(4)], axis=1))


def test_objects_by_name_that_hold_records_are_recordings(tmp_path):
    pairs = {name: {"name": name, "data": RECORDS[:n], "by": {"me": 1}}
             for name, n in (("one", 5), ("two", 4))}  # fmt: skip
    (tmp_path / "a.json").write_text(json.dumps(pairs), encoding="utf-8")
    scenes = load_dataset(tmp_path / "a.json").scenes
    assert [(scene.name, len(scene.times)) for scene in scenes] == [("one", 4), ("two", 3)]


def test_what_is_nested_has_names_of_its_own():
    text = as_table('{"t": 0, "ball": [1, 2.5], "said": {"by": "me", "at": {"k": null}}}', "a")
    assert text == "t\tball_x\tball_y\tsaid_by\tsaid_at_k\n0\t1\t2.5\tme\t\n"


@pytest.mark.parametrize("text, said", [
    ("[]", "no records"), ("{}", "no records"), ("3", "no table"), ("[1, 2]", "no table"),
    ('{"t": 1}\n{"t": 2', "no JSON"), ('{"t": 1}\n7', "no record"),
    ('{"t": 1, "p": [1, 2, 3, 4]}', "no place"), ("[" * 100_000, "nested too deeply"),
    ('{"a": ' * 960 + "1" + "}" * 960, "nested too deeply"),
    ('{"t": 1}\n' + "[" * 100_000, "nested too deeply"),
])  # fmt: skip
def test_other_json_is_refused_with_a_remedy(text, said):
    with pytest.raises(DataError, match=said) as error:
        as_table(text, "a.json")
    assert "one record a row" in str(error.value)


@pytest.mark.parametrize("indent", [None, 1, "lines"])
def test_errors_name_the_record_and_no_line_of_what_was_made_of_it(indent, tmp_path):
    records = [dict(each) for each in RECORDS]
    records[3]["x"] = "much"
    path = tmp_path / ("a.jsonl" if indent == "lines" else "a.json")
    text = "\n".join(map(json.dumps, records)) if indent == "lines" else None
    path.write_text(text or json.dumps(records, indent=indent), encoding="utf-8")
    with pytest.raises(DataError, match="record 4, column x: expected a number, got 'much'"):
        load_dataset(path)
