"""What the site makes of its pages besides their text.

- The pages that a page lists, and that stand in its folder, are below it in the navigation.
- On every page the first use of a word of the glossary leads there.
- A search lists what a newcomer reads before what only a maintainer does, by the groups of index.md.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Final

from docutils import nodes
from sphinx import addnodes
from sphinx.application import Sphinx

_INDEX: Final = "docs/site/index"
_GLOSSARY: Final = "docs/glossary"
_LISTS: Final = {"docs/session-file": "session-file/", "docs/devices": "devices/", "docs/decisions/README": ""}
"""Pages that list others, and the folder, seen from each, that these stand in."""

_ORDINARY: Final = frozenset(
    {"end", "face", "fault", "gate", "held", "holding", "incident", "join", "life", "notice", "part", "port", "room"}
    | {"run", "share", "site", "tool", "visit", "world"}
)
"""Words of the glossary that have an ordinary sense as well: where they are meant, the page itself has the link."""

_ADDED: Final = {"Begin here": 3, "Guides": 2, "Reference": 1, "Theory": 0}
"""What a page's group adds to Sphinx's score of a hit: 15 for a word of a heading, 5 for a word of the text.

So headings decide among these. A page of another group comes after all of them, in the groups' order.
"""

_NAMED: Final = 4
"""What is added where the page's title has the word, for Sphinx does not tell a title from another heading."""

_LATER: Final = 100
_TREE: Final = re.compile(r"^```\{toctree\}\n:caption: ([^\n]+)\n:maxdepth: 1\n\n(.*?)^```", re.MULTILINE | re.DOTALL)
_NOT_PROSE: Final = (
    *(nodes.title, nodes.reference, nodes.literal, nodes.FixedTextElement, nodes.math, nodes.raw, nodes.caption),
    addnodes.desc_signature,
)


def groups(index: str) -> dict[str, list[str]]:
    """The groups of the first page, in their order, each with its entries as they stand there."""
    return {caption: entries.split() for caption, entries in _TREE.findall(index)}


def listed(page: str, folder: str) -> list[str]:
    """The pages of a folder to which a page has links, in the order of the first of each, without ``.md``."""
    return list(dict.fromkeys(re.findall(rf"\]\(({re.escape(folder)}[\w.-]+)\.md[)#]", page)))


def put_below(_site: Sphinx, docname: str, source: list[str]) -> None:
    """Give a page that lists others their places below it."""
    if docname in _LISTS:
        entries = "\n".join(listed(source[0], _LISTS[docname]))
        source[0] += f"\n\n```{{toctree}}\n:hidden:\n\n{entries}\n```\n"


def grouped(source: Path) -> dict[str, list[str]]:
    """By group of the first page, the names of its pages in their order, each with those below it."""
    found: dict[str, list[str]] = {}
    base = source / Path(_INDEX).parent
    for group, entries in groups((source / f"{_INDEX}.md").read_text(encoding="utf-8")).items():
        found[group] = []
        for name in (os.path.relpath((base / entry).resolve(), source) for entry in entries):
            page = (source / f"{name}.md").read_text(encoding="utf-8")
            below = listed(page, _LISTS[name]) if name in _LISTS else []
            found[group] += [name, *(str(Path(name).parent / one) for one in below)]
    return found


def scores(source: Path) -> dict[str, int]:
    """What is added to the score of a hit on each page."""
    return {
        name: _ADDED.get(group, -_LATER * place)
        for place, (group, names) in enumerate(grouped(source).items())
        for name in names
    }


def write_scorer(site: Sphinx, _config: object) -> None:
    """Put the scores where the search of the site takes them from. It takes all of a scorer's numbers, or none."""
    file = Path(site.doctreedir) / "scorer.js"
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(
        f"""var Scorer = {{
  added: {json.dumps(scores(Path(site.srcdir)))},
  words: (new URLSearchParams(location.search).get("q") ?? "").toLowerCase().split(/\\s+/).filter(Boolean),
  named: (title) => Scorer.words.some((word) => title.toLowerCase().includes(word)),
  score: ([docname, title, , , score]) =>
    score + (Scorer.added[docname] ?? 0) + (Scorer.named(title) ? {_NAMED} : 0),
  objNameMatch: 11, objPartialMatch: 6, objPrio: {{0: 15, 1: 5, 2: -5}}, objPrioDefault: 0,
  title: 15, partialTitle: 7, term: 5, partialTerm: 2,
}};
""",
        encoding="utf-8",
    )
    site.config.html_search_scorer = str(file)


def glossary_words(page: str) -> dict[str, str]:
    """The words of the glossary that the site links, as they stand in its headings, each with that heading.

    Single Latin letters are left out: too many of them are names of something else.
    """
    headings = re.findall(r"^### (.+)$", page, re.MULTILINE)
    words = {word: heading for heading in headings for word in heading.split(", ")}
    letters = {word for word in words if re.fullmatch(r"\w\*?", word, re.ASCII)}
    return {word: heading for word, heading in words.items() if word not in _ORDINARY | letters}


def forms(word: str) -> str:
    """A pattern of a word in a text: as it stands, with a capital, or in the plural; of a symbol, itself."""
    if not word.isascii() or "_" in word:
        return rf"(?<!\w){re.escape(word)}(?!\w)"
    rest = re.escape(word[1:]).replace("'", "['’]")
    plural = f"{rest[:-1]}(?:y|ies)" if word.endswith("y") else f"{rest}(?:s|es)?"
    return rf"(?<!\w)[{word[0].upper()}{word[0]}]{plural}(?!\w)"


def link_words(site: Sphinx, doctree: nodes.document, docname: str) -> None:
    """Make the first use of each word of the glossary a link to it, where the page does not have one of its own."""
    if docname == _GLOSSARY or site.builder.format != "html":
        return
    target = site.builder.get_relative_uri(docname, _GLOSSARY)
    ids = {title.replace("’", "'"): anchor for _, anchor, title in site.env.metadata[_GLOSSARY]["myst_slugs"].values()}
    words = glossary_words((Path(site.srcdir) / f"{_GLOSSARY}.md").read_text(encoding="utf-8"))
    linked = {one["refuri"] for one in doctree.findall(nodes.reference) if "refuri" in one}
    left = {word: f"{target}#{ids[heading]}" for word, heading in words.items()}
    left = {word: uri for word, uri in left.items() if uri not in linked}
    for text in [*doctree.findall(nodes.Text)]:
        if not any(isinstance(one, _NOT_PROSE) for one in _above(text)):
            _link(text, left)


def _above(node: nodes.Node) -> Iterator[nodes.Node]:
    """The elements that a node is in."""
    while (node := node.parent) is not None:
        yield node


def _link(text: nodes.Text, left: dict[str, str]) -> None:
    """Make links of the words that are ``left`` and occur in a text, and take all words of their entries away."""
    parts: list[nodes.Node] = []
    rest = str(text)
    while left and (found := _first(rest, left)):
        word, start, end = found
        uri = left[word]
        for same in [one for one, other in left.items() if other == uri]:
            del left[same]
        link = nodes.reference("", rest[start:end], internal=True, refuri=uri, classes=["word"])
        parts += [nodes.Text(rest[:start]), link]
        rest = rest[end:]
    if parts:
        text.parent.replace(text, [*parts, nodes.Text(rest)])


def _first(text: str, words: Iterable[str]) -> tuple[str, int, int] | None:
    """Which of the words occurs first in a text, the longest of several there, and from where to where."""
    found = [(at.start(), -at.end(), word) for word in words if (at := re.search(forms(word), text))]
    return (min(found)[2], min(found)[0], -min(found)[1]) if found else None


def setup(site: Sphinx) -> dict[str, bool]:
    """Called by Sphinx."""
    site.connect("source-read", put_below)
    site.connect("config-inited", write_scorer)
    site.connect("doctree-resolved", link_words)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
