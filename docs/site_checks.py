"""What the site checks beyond Sphinx: names and commands in its texts exist, and are links to their pages."""

from __future__ import annotations

import ast
import inspect
import re
import textwrap
from pathlib import Path

import generate
import texts
from docutils import nodes
from sphinx.application import Sphinx
from sphinx.errors import ExtensionError
from sphinx.transforms.post_transforms import SphinxPostTransform
from sphinx.util import logging
from sphinx.util.nodes import make_refnode

SECTION = re.compile(r"^(Args|Returns|Raises|Yields):$", re.MULTILINE)
logger = logging.getLogger(__name__)


class Names(SphinxPostTransform):
    """Links `xd.NAME` and `xdex COMMAND` in texts, and tells of those that do not exist."""

    default_priority = 5

    def run(self, **kwargs: object) -> None:
        """Walks the literals of a page."""
        for block in self.document.findall(nodes.literal_block):
            if block.get("language") in ("sh", "bash", "console"):
                for line in texts.commands_in(block.astext()):
                    self._check(line, block)
        for literal in list(self.document.findall(nodes.literal)):
            if isinstance(literal.parent, nodes.reference):
                continue
            text = literal.astext()
            if text.startswith("xdex "):
                self._check(text, literal)
            elif match := texts.NAME.match(text):
                self._link(match[1], literal)

    def _check(self, line: str, node: nodes.Node) -> None:
        if (wrong := texts.wrong_command(line)) is not None:
            logger.warning("%s", wrong, location=node, type="xdex", subtype="command")

    def _link(self, name: str, literal: nodes.literal) -> None:
        page = f"generated/api/{name}"
        if page not in self.env.found_docs:
            logger.warning("xd.%s is no public name", name, location=literal, type="xdex", subtype="name")
            return
        here, builder = self.env.docname, self.app.builder
        literal.replace_self(make_refnode(builder, here, page, "", literal.deepcopy()))


def escape(app: Sphinx, what: str, name: str, obj: object, options: object, lines: list[str]) -> None:
    """Makes plain text of docstrings safe for reStructuredText: stars, bars and underscores mean themselves."""

    def plain(text: str) -> str:
        return re.sub(r"(?<=\w)_(?=\W|$)", r"\\_", text.replace("*", "\\*").replace("|", "\\|"))

    code = False
    for k, line in enumerate(lines):
        if line.strip().endswith("::"):
            code = True
        elif line and not line.startswith(" "):
            code = False
        if not code:
            pieces = line.split("`")
            lines[k] = "`".join(piece if i % 2 else plain(piece) for i, piece in enumerate(pieces))


def written_signature(
    app: Sphinx, what: str, name: str, obj: object, options: object, args: str | None, returns: str | None
) -> tuple[str, str | None] | None:
    """A signature as its author wrote it: `Array` and not what the alias stands for."""
    try:
        node = ast.parse(textwrap.dedent(inspect.getsource(inspect.unwrap(obj)))).body[0]  # type: ignore[arg-type]
    except (OSError, TypeError, SyntaxError, IndexError):
        return None
    if isinstance(node, ast.ClassDef):
        made = [part for part in node.body if isinstance(part, ast.FunctionDef) and part.name == "__init__"]
        if not made:
            fields = [part for part in node.body if isinstance(part, ast.AnnAssign) and part.simple]
            texts = [ast.unparse(part) for part in fields if "ClassVar" not in ast.unparse(part.annotation)]
            return (f"({', '.join(texts)})", None) if args not in (None, "()") else None
        node = made[0]
    if not isinstance(node, ast.FunctionDef):
        return None
    if node.args.args and node.args.args[0].arg in ("self", "cls"):
        node.args.args.pop(0)
    result = ast.unparse(node.returns) if node.returns is not None and what != "class" else None
    return f"({ast.unparse(node.args)})", result


def as_written(app: Sphinx, what: str, name: str, obj: object, options: object, lines: list[str]) -> None:
    """Undoes what napoleon makes of a property's `words: more words`, which it takes for a type."""
    text = inspect.getdoc(obj) or ""
    if what in ("property", "attribute") and ":" in text.splitlines()[0] and not SECTION.search(text):
        lines[:] = [*text.splitlines(), ""]
        escape(app, what, name, obj, options, lines)


def finish(app: Sphinx, error: Exception | None) -> None:
    """Puts the live pages into the site, and checks that what pages embed is there."""
    if error is not None or app.builder.format != "html":
        return
    html = Path(app.outdir)
    generate.copy_live_pages(html)
    for page, address in generate.embedded(html):
        if not (page.parent / address).resolve().is_file():
            raise ExtensionError(f"{page.relative_to(html)} embeds {address}, which is not there")


def setup(app: Sphinx) -> dict[str, bool]:
    """Connects all of this."""
    app.connect("builder-inited", lambda app: generate.write_all())
    app.connect("autodoc-process-docstring", escape, priority=400)
    app.connect("autodoc-process-docstring", as_written, priority=600)
    app.connect("autodoc-process-signature", written_signature)
    app.connect("build-finished", finish)
    app.add_post_transform(Names)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
