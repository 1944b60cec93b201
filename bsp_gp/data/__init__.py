"""What was measured: entities, scenes, data sets, and the files they come from.

The way of a file, and who does what on it:

1. `tables` is the door: a folder, a file, several (`several`), DataFrames, or a Tracker project
   (`trk`). What is said beside the data is a `declaration`.
2. `sources` gives text, of whatever the file is: encodings, workbooks, archives (`zipped`), JSON
   (`records`), arrays of MATLAB and NumPy (`arrays`), receivers (`gps`), particles (`molecules`),
   and what stands below the preambles of programs (`preambles`, with `horizons`, `orbits` and
   `minor_planets`).
3. `sniffing` finds the header, the delimiter and the rows (`header_lines`), `headings` tells what
   the names mean (`words`, ``words.toml``, `polar_words`), and `unnamed` what columns without names
   may be. `glance` shows that much.
4. `formats` reads the rows into one long `table`, whatever stood side by side (`wide`), rounded or
   stepwise (`steps`), as dates (`dates`) or without times (`untimed`).
5. `reading` makes scenes of it, step by step, and has the order of all these steps.

What has scenes already is asked and mended by `noise`, `point_errors`, `logged`, `split`, `flat`,
`torn`, `blocks`, `stretches` and `vertical`; `folder` writes a data set out again. The nouns are in
`scene`.
"""
