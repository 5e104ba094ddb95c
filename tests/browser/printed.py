#!/usr/bin/env python3
"""Checks pages printed as PDF: `printed.py PAGE.html...`.

Each text of a page must be in the PDF, and no line may begin with the unit of the number above it. Beside a file
`assessment.json`, the first page must state the identity of the report, each page must have it at its foot, and the PDF
must contain the strengths of all claims and the results of all gates. Needs chromium and pdftotext on the path; without
them prints a message and ends with 77.
"""

import html
import json
import re
import shutil
import subprocess
import sys
import tempfile
from html.parser import HTMLParser
from pathlib import Path

SKIPPED = 77
# Elements that are useless on paper, and figures, whose texts do not wrap.
LEFT_OUT = {"head", "nav", "script", "svg"}
VOID = {"br", "input", "meta"}


class Texts(HTMLParser):
    """Parser that collects the texts of a page that must be printed."""

    def __init__(self):
        super().__init__()
        self.open, self.texts = [], []

    def handle_starttag(self, tag, attributes):
        if tag not in VOID:
            self.open.append((tag, tag in LEFT_OUT))

    def handle_endtag(self, tag):
        if tag not in VOID:
            assert self.open.pop()[0] == tag, f"</{tag}> closes another element"

    def handle_data(self, data):
        if not any(left_out for _, left_out in self.open):
            self.texts.append(data)


def without_spaces(text):
    """Returns the text without white space."""
    return re.sub(r"\s+", "", text)


def without_foot(page, title):
    """Returns the text of a printed page without its foot: title and number, which are the first lines."""
    lines = page.splitlines(keepends=True)
    while lines and (lines[0].strip() == title or re.fullmatch(r"\d+ / \d+", lines[0].strip())):
        lines.pop(0)
    return "".join(lines)


def check(chromium, page, folder):
    """Prints a page as PDF; ends the program with an error if texts are missing in the PDF."""
    pdf = folder / "printed.pdf"
    options = [
        "--headless",
        "--no-sandbox",
        "--disable-gpu",
        "--disable-dev-shm-usage",
        "--no-pdf-header-footer",
        f"--user-data-dir={folder}/profile",
    ]
    subprocess.run(
        [chromium, *options, f"--print-to-pdf={pdf}", page.resolve().as_uri()],
        check=True,
        capture_output=True,
        timeout=900,
    )
    printed = subprocess.run(["pdftotext", "-raw", pdf, "-"], check=True, capture_output=True, text=True).stdout
    parser = Texts()
    parser.feed(page.read_text())
    title = html.unescape(re.search(r"<title>(.*?)</title>", page.read_text())[1])
    pages = printed.rstrip("\f").split("\f")
    whole = without_spaces("".join(without_foot(each, title) for each in pages))
    missing = [text for text in parser.texts if without_spaces(text) not in whole]
    dangling = re.findall(r"^.*\d\n\(?(?:m/s|m²/s³|m|s|%|km/h)\b.*", printed, re.MULTILINE)
    counts = f"{len(missing)} missing in the PDF, {len(dangling)} lines that begin with a unit"
    print(f"{page.name}: {len(parser.texts)} texts, {counts}")
    evidence = page.with_name("assessment.json")
    if evidence.exists() and "identity" in (report := json.loads(evidence.read_text())):
        missing += check_report(pages, report)
    if not parser.texts or missing or dangling:
        sys.exit("\n".join(["missing:", *missing[:20], "dangling:", *dangling[:20]]))


def check_report(pages, evidence):
    """Returns what the pages of a printed report lack: identity, strengths and gates."""
    identity, run = evidence["identity"], evidence["provenance"]["run_info"]
    subject = identity["subject_sha256"]
    subject = f" (SHA-256 {subject[:12]})" if subject else ""
    foot = f"Assessment of {identity['subject']}{subject}, {run['at'][:10]}, crumple {identity['crumple']}"
    first = without_spaces(pages[0])
    hashes = [identity[field] for field in ("subject_sha256", "configuration_sha256", "crumple_commit")]
    wanted = [*hashes, run["at"], identity["crumple"]]
    missing = [f"page 1: {part}" for part in wanted if part and without_spaces(part) not in first]
    for number, page in enumerate(pages, 1):
        if without_spaces(foot) not in without_spaces(page):
            missing.append(f"page {number}: {foot}")
    whole = without_spaces("".join(pages))
    statuses = [status for row in evidence["summary"]["claims"] for status in row["statuses"]]
    words = {status["strength"].replace("_", " ") for status in statuses}
    gates = [part for gate in evidence["summary"]["gates"] for part in (gate["gate"], gate["reason"])]
    texts = [text.replace("`", "") for text in [*words, *gates]]
    return missing + [text for text in texts if without_spaces(text) not in whole]


def main(*pages):
    """Checks each page."""
    chromium = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if not chromium or not shutil.which("pdftotext"):
        print("skipped: no chromium, or no pdftotext")
        sys.exit(SKIPPED)
    with tempfile.TemporaryDirectory() as folder:
        for page in pages:
            check(chromium, Path(page), Path(folder))


if __name__ == "__main__":
    main(*sys.argv[1:])
