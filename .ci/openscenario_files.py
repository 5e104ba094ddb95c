"""Imports the examples of esmini and ASAM, and writes their tables: `openscenario_files.py CRUMPLE [FOLDER]`.

The files come from GitHub, or from FOLDER with the folders `esmini` and `alks` of these repositories. They are not part
of crumple. With `--write` the table in docs/exchange.md is replaced; without, it must be the same.
"""

import re
import subprocess
import sys
import tempfile
from pathlib import Path

# Repository and commit of each folder.
SOURCES = {
    "esmini": ("https://github.com/esmini/esmini", "77028d83"),
    "alks": ("https://github.com/asam-oss/OSC-ALKS-scenarios", "de21f22"),
}
# Tables: folder, folder of the files in it, what the files are, and the suffixes that names in the table omit.
TABLES = [
    ("esmini", "resources/xosc", "files", []),
    ("alks", "logical_scenarios/concrete_scenarios", "files", ["_template"]),
    ("alks", "logical_scenarios", "files of variations", ["_variation"]),
]
# Vehicle under test of files in which another vehicle has the only controller.
UNDER_TEST = {"cut-in_sloppy": "Ego"}
PAGE = Path(__file__).resolve().parent.parent / "docs" / "exchange.md"
BEGIN, END = "<!-- table of files: begin -->", "<!-- table of files: end -->"


def git(folder, *words):
    subprocess.run(["git", "-C", folder, *words], check=True, capture_output=True)


def fetch(name, folder):
    """Returns the folder of a repository, which is fetched at its commit if it is not there."""
    own = folder / name
    url, commit = SOURCES[name]
    if not own.exists():
        own.mkdir(parents=True)
        git(own, "init", "--quiet")
        git(own, "fetch", "--quiet", url)
        git(own, "checkout", "--quiet", commit)
    return own


def attempt(crumple, path, *options):
    """Returns the error of an import, which is empty for one that succeeds, and the number of written files."""
    with tempfile.TemporaryDirectory() as out:
        words = [crumple, "--quiet", "import", path, *options, "--out", out]
        done = subprocess.run(words, capture_output=True, text=True)
        count = len(list(Path(out).glob("*.toml")))
    assert done.returncode in (0, 2), f"{path}: exit code {done.returncode}: {done.stderr}"
    return done.stderr.strip() if done.returncode else "", count


def outcome(crumple, path):
    """Returns whether a file is imported, and a text for the table."""
    text = path.read_text(errors="replace")
    if "<ParameterValueDistribution>" in text:
        scenario = re.search(r'<ScenarioFile filepath="([^"]*)"', text)[1]
        first, count = attempt(crumple, path.parent / scenario, "--distribution", path)
        if not first:
            return True, f"imported as {count} variations of `{Path(scenario).name}`"
    elif path.stem in UNDER_TEST:
        name = UNDER_TEST[path.stem]
        first, _ = attempt(crumple, path, "--ego", name)
        if not first:
            return True, f"imported with `--ego {name}`"
    else:
        first, _ = attempt(crumple, path)
    if not first:
        return True, "imported"
    if "with --ego" in first and not attempt(crumple, path, "--ego", "Ego")[0]:
        return True, "imported with `--ego Ego`"
    # The place in the file, and the values of the first variation.
    reason = re.sub(r"^error: \S+:\d+: | \(with `[^`]*`\)", "", first.splitlines()[0])
    return False, reason.replace("|", "/")


def short_name(stem, suffixes):
    """Returns the name of a file in a table."""
    name = stem.removeprefix("alks_scenario_")
    for suffix in suffixes:
        name = name.replace(suffix, "")
    return name


def tables(crumple, folder):
    lines, counts = [], []
    for name, inside, what, suffixes in TABLES:
        url, commit = SOURCES[name]
        files = sorted((fetch(name, folder) / inside).glob("*.xosc"))
        rows = [(short_name(path.stem, suffixes), *outcome(crumple, path)) for path in files]
        good = [stem for stem, ok, _ in rows if ok]
        counts.append(f"{len(good)} of {len(rows)} {what} of {name}")
        lines += [f"[{name}]({url}) (commit {commit}): {len(good)} of {len(rows)} {what} are imported.", ""]
        lines += ["| file | result |", "|---|---|"]
        lines += [f"| {stem} | {text} |" for stem, _, text in rows]
        lines.append("")
    return "\n".join(lines), ", ".join(counts)


def main():
    words = [word for word in sys.argv[1:] if word != "--write"]
    crumple = Path(words[0]).resolve()
    with tempfile.TemporaryDirectory() as temporary:
        text, counts = tables(crumple, Path(words[1] if len(words) > 1 else temporary))
    page = PAGE.read_text()
    before, rest = page.split(BEGIN)
    old, after = rest.split(END)
    if "--write" in sys.argv:
        PAGE.write_text(f"{before}{BEGIN}\n\n{text}\n{END}{after}")
    else:
        assert old.strip() == text.strip(), "the table differs: run with --write"
    print(f"imported: {counts}")


if __name__ == "__main__":
    main()
