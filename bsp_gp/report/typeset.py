"""Laws typeset: LaTeX to SVG by matplotlib's mathtext, and a LaTeX document to go on with."""

import re
from html import escape

from matplotlib.font_manager import FontProperties
from matplotlib.mathtext import MathTextParser
from matplotlib.path import Path as Outline
from matplotlib.textpath import TextPath

from bsp_gp.report.numbers import NOT_KNOWN, rounded

_SIZE = 20.0  # points; the page scales by em
_MAX_LENGTH = 3000
_MARGIN = 1.0
_DRAW = {Outline.MOVETO: "M", Outline.LINETO: "L", Outline.CURVE3: "Q", Outline.CURVE4: "C"}
# What mathtext draws badly: hats over an index, growing bars, small fractions, leading signs.
_BETTER = (
    (re.compile(r"\\hat\{(\\mathbf\{\w\})(_\{\w+\})\}"), r"\\hat{\1}\2"),
    (re.compile(r"\\(left|right)\\\|"), r"\\|"),
    (re.compile(r"\\frac\b"), r"\\dfrac"),
    (re.compile(r"(\\sum_\{[^{}]*\})"), r"\1\\,"),
    (re.compile(r"^([-+]) "), r"\1\\;"),
)


def split_terms(latex):
    r"""Cut a sum at its outer signs.

    Examples
    --------
    >>> split_terms(r"a = b + \left(c + d\right) - {e + f}")
    ['a = b', '+ \\left(c + d\\right)', '- {e + f}']
    """
    parts, start, depth = [], 0, 0
    for match in re.finditer(r"\\left|\\right|\\[{}]|[{}]|(?<![=(]) [-+](?= )", latex):
        token = match.group()
        if token in ("{", r"\left"):
            depth += 1
        elif token in ("}", r"\right"):
            depth -= 1
        elif token in (" +", " -") and depth == 0:
            parts.append(latex[start : match.start()].strip())
            start = match.start() + 1
    parts.append(latex[start:].strip())
    return [re.sub(r"^\+ -", "- ", part) for part in parts]


def to_svg(latex):
    """Typeset an equation as a run of inline SVG drawings, one per term so that lines can break.

    None if mathtext cannot read the equation: show it as text then.
    """
    if not latex.strip() or len(latex) > _MAX_LENGTH:
        return None
    terms = split_terms(latex)
    for pattern, better in _BETTER:
        terms = [pattern.sub(better, term) for term in terms]
    try:
        return "\n".join(_draw(term) for term in terms)
    except ValueError:
        return None


def _draw(latex):
    if "$" in latex:
        raise ValueError("a dollar sign ends the equation")
    font = FontProperties(family="DejaVu Sans", math_fontfamily="stix", size=_SIZE)
    text = f"${latex}$"
    width, _, depth, glyphs, rectangles = MathTextParser("path").parse(text, 72, font)
    if not glyphs and not rectangles:
        raise ValueError("an empty equation")
    outline = TextPath((0, 0), text, size=_SIZE, prop=font)
    box = outline.get_extents()
    top, bottom = box.y1 + _MARGIN, min(box.y0, -depth) - _MARGIN
    width, height = max(width, box.x1) + 2 * _MARGIN, top - bottom
    return (
        f'<svg class="math" role="img" aria-label="{escape(latex, quote=True)}" '
        f'viewBox="{-_MARGIN:.1f} {-top:.1f} {width:.1f} {height:.1f}" '
        f'style="width:{width / _SIZE:.3f}em;height:{height / _SIZE:.3f}em;'
        f'vertical-align:{bottom / _SIZE:.3f}em"><path d="{_path_data(outline)}"/></svg>'
    )


def _path_data(outline):
    """An outline in the language of SVG paths, y downwards."""
    out = []
    for points, code in outline.iter_segments(curves=True, simplify=False):
        if code == Outline.CLOSEPOLY:
            out.append("Z")
            continue
        pairs = (f"{points[k]:.2f} {-points[k + 1]:.2f}" for k in range(0, len(points), 2))
        out.append(_DRAW[code] + " ".join(pairs))
    return "".join(out)


_TEX = {
    "\\": r"\textbackslash{}",
    "{": r"\{",
    "}": r"\}",
    "$": r"\$",
    "&": r"\&",
    "#": r"\#",
    "%": r"\%",
    "_": r"\_",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
    "−": "$-$",
    "–": "--",
    "·": r"$\cdot$",
    "µ": r"$\mu$",
    "μ": r"$\mu$",
}


def _tex(text):
    """Plain text for LaTeX; what pdflatex has no letter for becomes a question mark."""
    out = "".join(_TEX.get(c, c) if c.isprintable() else " " for c in str(text))
    return "".join(c if ord(c) < 0x250 else "?" for c in out)


def _tex_unit(unit):
    if unit in ("", "1"):
        return "1"
    parts = re.split(r"\^\(?([-+]?\d+)\)?", unit)
    plain, powers = [_tex(p).replace("*", r"\,") for p in parts[::2]], [*parts[1::2], ""]
    return "".join(p + (f"$^{{{n}}}$" if n else "") for p, n in zip(plain, powers, strict=True))


def law_document(report):
    """A LaTeX document with the law and its constants, complete with a preamble."""
    if to_svg(report.law_latex) is None:
        equation = [r"\begin{quote}\ttfamily", _tex(report.law_text), r"\end{quote}"]
    else:
        first, *rest = split_terms(report.law_latex)
        left, equals, right = first.partition(" = ")
        body = rf"{left} ={{}}& {right}" if equals else rf"& {first}"
        body += "".join(rf" \\ & {term}" for term in rest)
        equation = [r"\begin{align*}", body, r"\end{align*}"]
    lines = [
        r"\documentclass{article}", r"\usepackage[T1]{fontenc}", r"\usepackage[utf8]{inputenc}",
        r"\usepackage{amsmath,longtable}", r"\begin{document}", *equation,
    ]  # fmt: skip
    if report.constants:
        lines += [
            r"\begin{longtable}{llrrrl}",
            r"\hline",
            r"constant & entity & value & \multicolumn{2}{c}{90\,\% interval} & unit \\",
            r"\hline",
        ]
        for c in report.constants:
            value, low, high, power = rounded(c.value, c.low, c.high)
            if c.state == "undetermined":
                value, power = "undetermined", ""
            elif c.state == "at_bound":
                low, high = "at its bound", NOT_KNOWN
            exponent = power.translate(str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁻⁺", "0123456789-+"))
            exponent = exponent.replace(" × 10", "")
            tail = rf"$\,\times 10^{{{exponent}}}$" if exponent else ""
            cells = [_tex(c.name), _tex(c.entity)]
            cells += [_tex(p) + (tail if p[-1:].isdigit() else "") for p in (value, low, high)]
            lines.append(" & ".join([*cells, _tex_unit(c.unit)]) + r" \\")
        lines += [r"\hline", r"\end{longtable}"]
    lines.append(r"\end{document}")
    return "\n".join(lines) + "\n"
