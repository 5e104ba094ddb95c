"""Pages and links: `book.py links`, `book.py gather PROGRAM FOLDER` and `book.py check FOLDER`."""

import json
import re
import shutil
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path

REPOSITORY = "https://github.com/crumple-rs/crumple/blob/main/"
SCHEMAS = ["crates", "corpora"]
GENERATED = (Path("docs/reference/commands.md"), Path("docs/reference/formats.md"))


def gather(program, folder):
    """Copies docs/, sends links that lead out of it to the repository, and writes the pages that are made."""
    folder, docs = Path(folder), Path("docs")
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(docs, folder / "src", ignore=shutil.ignore_patterns("book.toml"))
    shutil.copy(docs / "book.toml", folder / "book.toml")
    for page in (folder / "src").rglob("*.md"):
        place = docs / page.relative_to(folder / "src")
        page.write_text(with_links(page.read_text(), place))
    reference = folder / "src" / "reference"
    reference.mkdir(exist_ok=True)
    (reference / "commands.md").write_text(commands(program))
    (reference / "formats.md").write_text(formats())


def links():
    """Checks that each link of a Markdown file to a file of the repository leads to a file and to a heading that exist."""

    def anchors(page):
        headings = re.findall(r"^#+ +(.*)$", re.sub(r"^```.*?^```", "", page.read_text(), flags=re.M | re.S), re.M)
        return {re.sub(r"[^\w\- ]", "", heading.lower()).strip().replace(" ", "-") for heading in headings}

    broken, count = [], 0
    listed = subprocess.run(["git", "ls-files", "-co", "--exclude-standard", "*.md"], capture_output=True, text=True, check=True)
    for page in map(Path, listed.stdout.split()):
        for link in re.findall(r"\]\(([^)\s]+)\)", re.sub(r"^```.*?^```|`[^`\n]*`", "", page.read_text(), flags=re.M | re.S)):
            target, _, part = link.partition("#")
            if "://" in target or target.startswith("mailto:"):
                continue
            path = page.parent / target if target else page
            count += 1
            is_generated = path.resolve() in map(Path.resolve, GENERATED)
            if not (path.exists() or is_generated) or part and path.suffix == ".md" and path.exists() and part not in anchors(path):
                broken.append(f"{page}: {link}")
    if broken:
        sys.exit("links that lead nowhere:\n  " + "\n  ".join(broken))
    print(f"{count} links lead somewhere")


def with_links(text, place):
    """A page whose links to files of the repository lead there; one to nothing is an error."""

    def sent(link):
        target, _, part = link[1].partition("#")
        if not target or "://" in target or target.startswith("mailto:"):
            return link[0]
        path = (place.parent / target).resolve()
        inside = path.relative_to(Path.cwd())
        is_made = inside in GENERATED
        if not path.exists() and not is_made:
            sys.exit(f"{place}: the link to {target} leads nowhere")
        if inside.parts[0] == "docs":
            return link[0]
        return f"]({REPOSITORY}{inside.as_posix()}{'#' + part if part else ''})"

    return re.sub(r"\]\(([^)\s]+)\)", sent, text)


def said(program, *arguments):
    """What a command prints as its help, on a page of 100 columns."""
    ran = subprocess.run([program, *arguments, "--help"], capture_output=True, text=True, check=True, env={"COLUMNS": "100"})
    return ran.stdout


def subcommands(text):
    """The names under `Commands:`."""
    listed = re.search(r"^Commands:\n((?:  .*\n|\n)+)", text, re.MULTILINE)
    names = re.findall(r"^  ([a-z][\w-]*)", listed[1], re.MULTILINE) if listed else []
    return [name for name in names if name != "help"]


def commands(program):
    """All help there is."""
    whole = said(program)
    page = ["# Commands and options\n", "Made from the program's own help.\n", f"```text\n{whole}```\n"]

    def add(path):
        text = said(program, *path)
        page.extend([f"{'#' * (1 + len(path))} crumple {' '.join(path)}\n", f"```text\n{text}```\n"])
        for name in subcommands(text):
            add([*path, name])

    for name in subcommands(whole):
        add([name])
    return "\n".join(page)


def formats():
    """A table of fields for each schema."""
    page = ["# Formats and their schemas\n", "Made from the JSON schemas, which are made from the program's types.\n"]
    files = sorted(path for top in SCHEMAS for path in Path(top).rglob("*.schema.json"))
    for path in files:
        schema = json.loads(path.read_text())
        page.append(f"## {schema.get('title', path.stem)}\n")
        page.append(f"[{path.name}]({REPOSITORY}{path.as_posix()}). {schema.get('description', '')}\n")
        page.append(fields(schema))
        for name, inner in sorted(schema.get("$defs", {}).items()):
            if inner.get("properties"):
                page.append(f"### {name} ({path.stem.removesuffix('.schema')})\n")
                page.append(inner.get("description", "") + "\n")
                page.append(fields(inner))
    return "\n".join(page)


def fields(schema):
    """The fields of an object."""
    rows = ["| field | type | what |", "|---|---|---|"]
    required = set(schema.get("required", []))
    for name, field in schema.get("properties", {}).items():
        what = field.get("description", "").replace("\n", " ").replace("|", "\\|")
        mark = "" if name in required else ", may be left out"
        rows.append(f"| `{name}` | {typed(field)}{mark} | {what} |")
    return "\n".join(rows) + "\n" if len(rows) > 2 else ""


def typed(field):
    """The type in words."""
    if "$ref" in field:
        return field["$ref"].rsplit("/", 1)[-1]
    if "const" in field:
        return f"`{json.dumps(field['const'])}`"
    for several in ("anyOf", "oneOf", "allOf"):
        if several in field:
            kinds = [typed(one) for one in field[several] if one.get("type") != "null"]
            return " or ".join(dict.fromkeys(kinds))
    kind = field.get("type", "anything")
    kinds = [one for one in kind if one != "null"] if isinstance(kind, list) else [kind]
    if kinds == ["array"]:
        return f"list of {typed(field.get('items', {}))}"
    return " or ".join(kinds)


class Links(HTMLParser):
    """The links and anchors of a page."""

    def __init__(self):
        """Nothing is known yet."""
        super().__init__()
        self.links, self.anchors = [], set()

    def handle_starttag(self, tag, attributes):
        """Takes note of a tag."""
        attributes = dict(attributes)
        if attributes.get("id"):
            self.anchors.add(attributes["id"])
        for name in ("href", "src"):
            if attributes.get(name):
                self.links.append(attributes[name])


def check(folder):
    """Every link within the book leads to a page and an anchor that are there."""
    pages = {}
    for path in Path(folder).rglob("*.html"):
        pages[path.resolve()] = Links()
        pages[path.resolve()].feed(path.read_text())
    broken, looked_at = [], 0
    for path, page in pages.items():
        # The 404 page and the print page are generated from the others.
        if path.name in ("404.html", "print.html", "toc.html"):
            continue
        for link in page.links:
            if "://" in link or link.startswith(("mailto:", "data:", "javascript:")):
                continue
            target, _, part = link.partition("#")
            looked_at += 1
            there = (path.parent / target).resolve() if target else path
            if not there.exists():
                broken.append(f"{path.name}: {link}")
            elif part and there in pages and part not in pages[there].anchors:
                broken.append(f"{path.name}: {link} (no such place)")
    if broken:
        sys.exit("links that lead nowhere:\n  " + "\n  ".join(sorted(set(broken))))
    print(f"{len(pages)} pages, {looked_at} links within, each leads somewhere")


if __name__ == "__main__":
    {"links": links, "gather": gather, "check": check}[sys.argv[1]](*sys.argv[2:])
