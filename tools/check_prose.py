"""Check the English of pages, docstrings, comments and error messages.

    python tools/check_prose.py
    python tools/check_prose.py --show docstrings

Counts phrases that make sentences hard to read: openings such as "Of ...", clauses in place of a
noun, "that of", and words that CONTRIBUTING.md replaces. Exit code 1 if a kind of text has more
of them per 1,000 words than its limit.
"""

from __future__ import annotations

import argparse
import ast
import io
import re
import sys
import tokenize
from collections import Counter, defaultdict
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PAGES = ["README.md", "CONTRIBUTING.md", "docs/**/*.md", "examples/*/README.md"]
CODE = ["src/**/*.py"]
# Largest number of phrases per 1,000 words.
LIMITS = {"pages": 2.0, "docstrings": 1.0, "comments": 1.0, "messages": 1.0}

PHRASES = {
    "opening": r"(?:^|[.;:!?] )(?:Of|As to|To what|That of|Those of) \w",
    "clause for a noun": r"\b(?:[Ww]hat|(?:of|for|than|from|with|by) what) "
    r"(?:is|are|was|has|have|comes|goes|lies|stands|there|it|they|no|one|a|the)\b",
    "that of": r"\b(?:that|those) of\b",
    "of which": r"\bof (?:which|whom|whose)\b",
    "way": r"\b(?:this|that|which|what|straight|direct|same|other|either|both|by|all) ways?\b",
    "place": r"\b(?:the|a|any|each|all|at|one|of) places?\b",
    "NaN": r"\b(?:not a|no) numbers?\b",
    "centre": r"\b[Mm]iddles?\b",
    "beside": r"\b[Bb]esides?\b",
    "private word": r"\b(?:is told|are told|told of|asked for|goes by|go by|by way of|as it stands|"
    r"so many|of (?:its|their) own|left of|in its turn)\b",
    "bare pronoun": r"\b(?:is|are) (?:one|none|so|they|two)(?=[.,;:)])",
}
PATTERNS = {name: re.compile(pattern) for name, pattern in PHRASES.items()}
# Parts of a page that are not prose: code, formulas, targets of links, and comments.
NOT_PROSE = re.compile(r"```.*?```|<!--.*?-->|\$[^$\n]+\$|`[^`]*`|\]\([^)]*\)|https?://\S+", re.S)


def texts_of_page(text: str) -> Iterator[tuple[str, str]]:
    for paragraph in re.split(r"\n\s*\n|\n(?=[-*|#])", NOT_PROSE.sub(" ", text)):
        yield "pages", " ".join(paragraph.split())


def texts_of_code(text: str) -> Iterator[tuple[str, str]]:
    """Yield docstrings, comments, and the texts of raised errors and warnings."""
    tree = ast.parse(text)
    for node in ast.walk(tree):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            if isinstance(node.value.value, str):
                yield "docstrings", " ".join(NOT_PROSE.sub(" ", node.value.value).split())
        elif isinstance(node, ast.Raise) or _warns(node):
            parts = (part.value for part in ast.walk(node) if isinstance(part, ast.Constant))
            yield "messages", " ".join(part for part in parts if isinstance(part, str))
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type == tokenize.COMMENT:
            yield "comments", token.string.lstrip("# ")


def _warns(node: ast.AST) -> bool:
    if not isinstance(node, ast.Call):
        return False
    name = getattr(node.func, "attr", getattr(node.func, "id", ""))
    return name in {"warn", "warn_caller"}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--show", choices=LIMITS, help="list the phrases of one kind of text")
    shown = parser.parse_args().show
    words: Counter[str] = Counter()
    hits: dict[str, list[str]] = defaultdict(list)
    for patterns, texts in ((PAGES, texts_of_page), (CODE, texts_of_code)):
        for path in sorted(path for pattern in patterns for path in ROOT.glob(pattern)):
            if "_build" in path.parts or "lessons" in path.parts:
                continue
            for kind, text in texts(path.read_text(encoding="utf-8")):
                words[kind] += len(text.split())
                for name, pattern in PATTERNS.items():
                    for match in pattern.finditer(text):
                        around = text[max(0, match.start() - 40) : match.end() + 40]
                        hits[kind].append(f"{path.relative_to(ROOT)}: {name}: ...{around}...")
    if shown:
        print(*hits[shown], sep="\n")
    failed = False
    for kind, limit in LIMITS.items():
        rate = 1000 * len(hits[kind]) / max(words[kind], 1)
        print(f"{kind:10} {words[kind]:7} words, {rate:4.1f} phrases per 1,000, limit {limit}")
        failed |= rate > limit
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
