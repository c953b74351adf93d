"""Formulas as MathML, which browsers draw by themselves: no script, and none from another site.

TeX in pages is turned by docutils' own converter, which knows much of LaTeX's mathematics but not
``\\tag{F1}``: the label is put beside the formula here, with the anchor ``eq-f1``.
"""

from __future__ import annotations

import re
from typing import Any

from docutils import nodes
from docutils.utils.math import MathError
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.util import logging

LOGGER = logging.getLogger(__name__)
# The converter leaves no room around functions' names: sin x, but sin(x).
NAME = re.compile(
    r"<mi[^>]*>(sinc|sinhc|sin|cos|sinh|cosh|exp|arccos|arctan|sign|det)</mi>"
    r"(\s*(?:</?m\w+>|<mn>2</mn>|\s)*<mo>&ApplyFunction;</mo>(?!\s*<mo stretchy))?"
)
# A bar is oftener a fence than an operator with room on its sides.
BARS = '<mo stretchy="false">|</mo>', '<mo lspace="0" rspace="0" stretchy="false">|</mo>'
TAG = re.compile(r"\s*\\tag\{([^}]+)\}")


def mathml(node: nodes.Node, as_block: bool) -> str:
    code = " ".join(TAG.sub("", node.astext()).split())
    try:
        drawn = tex2mathml(code, as_block=as_block).replace(*BARS)
    except MathError as error:
        LOGGER.warning("a formula that cannot be drawn: %s (%s)", code, error, location=node)
        return ""
    return NAME.sub(name_of_function, drawn)


def name_of_function(match: re.Match[str]) -> str:
    after, rest = ("0.17em", match[2]) if match[2] else ("0", "")
    return f'<mo form="prefix" lspace="0.17em" rspace="{after}">{match[1]}</mo>{rest}'


def inline(writer: Any, node: nodes.Node) -> None:
    writer.body.append(mathml(node, as_block=False))
    raise nodes.SkipNode


def block(writer: Any, node: nodes.Node) -> None:
    tag = TAG.search(node.astext())
    label = tag[1] if tag else ""
    anchor = f' id="eq-{label.lower()}"' if label else ""
    number = f'<span class="eqno">({label})</span>' if label else ""
    writer.body.append(f'<div class="formula"{anchor}>{mathml(node, as_block=True)}{number}</div>')
    raise nodes.SkipNode


def setup(app: Any) -> dict[str, bool]:
    app.add_html_math_renderer("mathml", (inline, None), (block, None))
    return {"parallel_read_safe": True}
