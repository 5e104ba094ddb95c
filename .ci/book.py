"""Gathers the pages of the book and checks links.

book.py links                    checks the links of all Markdown files
book.py gather PROGRAM FOLDER    writes the pages of the book
book.py check FOLDER             checks the links of the built book
"""

import json
import re
import shutil
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path

REPOSITORY = "https://github.com/crumple-rs/crumple/blob/main/"
SCHEMAS = ["crates", "corpora"]
GENERATED = "- [Commands and options](reference/commands.md)\n- [File formats](reference/formats.md)\n"
BEFORE_GENERATED = "- [Glossary](glossary.md)\n"


def gather(program, folder):
    """Copies docs/, redirects links out of it to the repository, and writes the generated pages."""
    folder, docs = Path(folder), Path("docs")
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(docs, folder / "src", ignore=shutil.ignore_patterns("book.toml"))
    shutil.copy(docs / "book.toml", folder / "book.toml")
    for page in (folder / "src").rglob("*.md"):
        place = docs / page.relative_to(folder / "src")
        page.write_text(redirect_links(page.read_text(), place))
    reference = folder / "src" / "reference"
    reference.mkdir(exist_ok=True)
    (reference / "commands.md").write_text(commands(program))
    (reference / "formats.md").write_text(formats())
    summary = folder / "src" / "SUMMARY.md"
    listed = summary.read_text()
    if BEFORE_GENERATED not in listed:
        sys.exit(f"docs/SUMMARY.md has no line {BEFORE_GENERATED.strip()}")
    summary.write_text(listed.replace(BEFORE_GENERATED, BEFORE_GENERATED + GENERATED))


def links():
    """Checks that links of Markdown files to files of the repository have existing targets and headings."""

    def anchors(page):
        headings = re.findall(r"^#+ +(.*)$", re.sub(r"^```.*?^```", "", page.read_text(), flags=re.M | re.S), re.M)
        return {re.sub(r"[^\w\- ]", "", heading.lower()).strip().replace(" ", "-") for heading in headings}

    broken, count = [], 0
    listed = subprocess.run(
        ["git", "ls-files", "-co", "--exclude-standard", "*.md"], capture_output=True, text=True, check=True
    )
    for page in map(Path, listed.stdout.split()):
        for link in re.findall(
            r"\]\(([^)\s]+)\)", re.sub(r"^```.*?^```|`[^`\n]*`", "", page.read_text(), flags=re.M | re.S)
        ):
            target, _, part = link.partition("#")
            if "://" in target or target.startswith("mailto:"):
                continue
            path = page.parent / target if target else page
            count += 1
            is_missing = not path.exists()
            has_headings = part and path.suffix == ".md" and path.exists()
            if is_missing or has_headings and part not in anchors(path):
                broken.append(f"{page}: {link}")
    if broken:
        sys.exit("broken links:\n  " + "\n  ".join(broken))
    print(f"{count} links, none broken")


def redirect_links(text, place):
    """Returns a page whose links to files outside of docs/ lead to the repository; fails at a broken link."""

    def redirect(link):
        target, _, part = link[1].partition("#")
        if not target or "://" in target or target.startswith("mailto:"):
            return link[0]
        path = (place.parent / target).resolve()
        inside = path.relative_to(Path.cwd())
        if not path.exists():
            sys.exit(f"{place}: the link to {target} is broken")
        if inside.parts[0] == "docs":
            return link[0]
        return f"]({REPOSITORY}{inside.as_posix()}{'#' + part if part else ''})"

    return re.sub(r"\]\(([^)\s]+)\)", redirect, text)


def help_text(program, *arguments):
    """Returns the help of a command, in 100 columns."""
    ran = subprocess.run(
        [program, *arguments, "--help"], capture_output=True, text=True, check=True, env={"COLUMNS": "100"}
    )
    return ran.stdout


def subcommands(text):
    """Returns the subcommands that a help text lists before its options."""
    listed = text.split("\nOptions:")[0].split("Usage:")[-1]
    return [name for name in re.findall(r"^  ([a-z][\w-]*) ", listed, re.MULTILINE) if name != "help"]


def commands(program):
    """Returns the page with the help of all commands."""
    whole = help_text(program)
    page = ["# Commands and options\n", "Generated from the help of the program.\n", f"```text\n{whole}```\n"]

    def add(path):
        text = help_text(program, *path)
        page.extend([f"{'#' * (1 + len(path))} crumple {' '.join(path)}\n", f"```text\n{text}```\n"])
        for name in subcommands(text):
            add([*path, name])

    for name in subcommands(whole):
        add([name])
    return "\n".join(page)


def formats():
    """Returns the page with a table of fields for each schema."""
    page = ["# Formats and their schemas\n", "Generated from the JSON schemas of the program.\n"]
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
    """Returns the table of an object's fields."""
    rows = ["| field | type | meaning |", "|---|---|---|"]
    required = set(schema.get("required", []))
    for name, field in schema.get("properties", {}).items():
        meaning = field.get("description", "").replace("\n", " ").replace("|", "\\|")
        mark = "" if name in required else ", optional"
        rows.append(f"| `{name}` | {type_name(field)}{mark} | {meaning} |")
    return "\n".join(rows) + "\n" if len(rows) > 2 else ""


def type_name(field):
    """Returns the type of a field in words."""
    if "$ref" in field:
        return field["$ref"].rsplit("/", 1)[-1]
    if "const" in field:
        return f"`{json.dumps(field['const'])}`"
    for several in ("anyOf", "oneOf", "allOf"):
        if several in field:
            kinds = [type_name(one) for one in field[several] if one.get("type") != "null"]
            return " or ".join(dict.fromkeys(kinds))
    kind = field.get("type", "anything")
    kinds = [one for one in kind if one != "null"] if isinstance(kind, list) else [kind]
    if kinds == ["array"]:
        return f"list of {type_name(field.get('items', {}))}"
    return " or ".join(kinds)


class Links(HTMLParser):
    """Parser that collects the links and anchors of a page."""

    def __init__(self):
        super().__init__()
        self.links, self.anchors = [], set()

    def handle_starttag(self, tag, attributes):
        """Collects the links and the anchor of a tag."""
        attributes = dict(attributes)
        if attributes.get("id"):
            self.anchors.add(attributes["id"])
        for name in ("href", "src"):
            if attributes.get(name):
                self.links.append(attributes[name])


def check(folder):
    """Checks that links within the book have existing pages and anchors."""
    pages = {}
    for path in Path(folder).rglob("*.html"):
        pages[path.resolve()] = Links()
        pages[path.resolve()].feed(path.read_text())
    broken, count = [], 0
    for path, page in pages.items():
        # The 404 page and the print page are generated from the others.
        if path.name in ("404.html", "print.html", "toc.html"):
            continue
        for link in page.links:
            if "://" in link or link.startswith(("mailto:", "data:", "javascript:")):
                continue
            target, _, part = link.partition("#")
            count += 1
            destination = (path.parent / target).resolve() if target else path
            if not destination.exists():
                broken.append(f"{path.name}: {link}")
            elif part and destination in pages and part not in pages[destination].anchors:
                broken.append(f"{path.name}: {link} (no such anchor)")
    if broken:
        sys.exit("broken links:\n  " + "\n  ".join(sorted(set(broken))))
    print(f"{len(pages)} pages, {count} internal links, none broken")


if __name__ == "__main__":
    {"links": links, "gather": gather, "check": check}[sys.argv[1]](*sys.argv[2:])
