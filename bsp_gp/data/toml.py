"""Reading TOML that others wrote: every defect is one kind of error, however it is found."""

import tomllib

MOST_LEVELS = 50
"""Tables and lists within each other."""
LARGEST = 2**63 - 1
"""As TOML has it; longer whole numbers have no place as floats."""


class TomlError(ValueError):
    """A text is no TOML that can be used; names the place where it is known."""


def parse_toml(content):
    """Parse the content of a TOML file, bytes with or without a byte order mark.

    Raises
    ------
    TomlError
        If it is no TOML, or nests too deeply, or holds whole numbers beyond 64 bits.
    UnicodeDecodeError
        If it is not UTF-8.
    """
    text = content.decode("utf-8-sig")
    try:
        tables = tomllib.loads(text)
    except RecursionError:
        raise TomlError(f"tables or lists nest more than {MOST_LEVELS} deep") from None
    except tomllib.TOMLDecodeError as error:
        raise TomlError(str(error)) from None
    except ValueError:  # Python's own bound on the digits of a whole number
        raise TomlError(_TOO_LONG) from None
    _check(tables)
    return tables


_TOO_LONG = f"a whole number is beyond ±{LARGEST}"


def _check(tables):
    todo = [(tables, 1)]
    while todo:
        value, level = todo.pop()
        if isinstance(value, int) and not -LARGEST - 1 <= value <= LARGEST:
            raise TomlError(_TOO_LONG)
        inner = value.values() if isinstance(value, dict) else value
        if isinstance(inner, str) or not hasattr(inner, "__iter__"):
            continue
        if level > MOST_LEVELS:
            raise TomlError(f"tables or lists nest more than {MOST_LEVELS} deep")
        todo.extend((item, level + 1) for item in inner)
