"""For people: figures, tables, the report in one file."""
