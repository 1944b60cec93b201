"""Words by which headings of tables mean something, in the languages of ``words.toml``."""

import re
import tomllib
import unicodedata
from functools import cache, lru_cache
from importlib.resources import files

_WIDE = str.maketrans("（）［］／：，＃　", "()[]/:,# ")
"""Signs as East Asian keyboards write them."""
_EAST = r"[\u2e80-\u30ff\u3400-\u9fff\uac00-\ud7af]"
_BORDER = re.compile(
    rf"(?<={_EAST})(?=[A-Za-z0-9])|(?<=[A-Za-z0-9])(?={_EAST})|(?<=[a-z]{{3}})(?=[XYZ](?![^\W_]))"
)
"""Between ``位置`` and ``x``, and in ``AccelerationX``, which nobody sets apart."""
_LETTERS = ("LATIN", "GREEK", "CYRILLIC")


@lru_cache(maxsize=1 << 14)  # a wide table is asked about its headings again and again
def folded(text):
    """A text in lower case without the accents of its letters, as long as it was."""
    return "".join(map(_plain, unicodedata.normalize("NFC", text)))


def _plain(letter):
    first = unicodedata.normalize("NFD", letter.lower())[0]
    return first if unicodedata.name(first, "").startswith(_LETTERS) else letter.lower()[0]


def plain_signs(text):
    """A text with brackets, slashes and colons as the West writes them."""
    return text.translate(_WIDE)


def apart(text):
    """A heading with a blank between letters of East Asia and ours, and before an axis."""
    return _BORDER.sub(" ", text)


@cache
def words_for(meaning):
    """All words of a meaning in ``words.toml``, folded."""
    by_language = _WORDS.get(meaning) or {"": _WORDS["others"][meaning]}
    return frozenset(folded(" ".join(by_language.values())).split())


def n_known_words(text):
    """How many words of a text, of those with letters beyond ASCII, mean something here."""
    words = re.findall(r"[^\W\d_]+", apart(plain_signs(text)))
    return sum(folded(word) in _KNOWN for word in words if not word.isascii())


def unit_words():
    """Unit as people write it out, in lower case -> unit as it is known."""
    return {word: unit for unit, words in _WORDS["units"].items() for word in words.split()}


_WORDS = tomllib.loads(files(__package__).joinpath("words.toml").read_text(encoding="utf-8"))
_KNOWN = frozenset().union(
    *(words_for(meaning) for meaning in _WORDS if meaning != "others"),  # these have lone signs
    map(folded, unit_words()),
)
