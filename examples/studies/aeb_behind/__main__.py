"""Runs the study of rear-end collisions, and recomputes its page. Needs only Python 3.11.

    aeb_behind run CRUMPLE FOLDER           runs all assessments in FOLDER with two seeds, and the sensitivity
    aeb_behind page FOLDER PAGE [--write]   compares the page, its pictures and tables with the runs, or writes them
    aeb_behind bootstrap FOLDER             compares the errors of the answer about the field with those of a bootstrap
    aeb_behind second CRUMPLE [--write]     runs crumple and the second simulator, and compares ten figures

`run` refuses a folder with results of another program, and `page` results of other settings.
"""

import json
import sys
from pathlib import Path

import bootstrap
import page
import second
import sensitivity
import study


def suite_verdicts(folder, section):
    """Returns whether each system passes every test of a section of the suite `fmvss-127`."""
    verdicts = {}
    clauses = json.loads((folder / "suite/fmvss-127.json").read_text())["clauses"]
    for test in (test for clause in clauses if clause["clause"].startswith(section) for test in clause["tests"]):
        for one in test["controllers"]:
            name = study.short_name(one["controller"])
            passed = one["verdict"]["kind"] == "passed" and verdicts.get(name, "yes") == "yes"
            verdicts[name] = "yes" if passed else "no"
    return verdicts


if __name__ == "__main__":
    is_written = "--write" in sys.argv
    match [argument for argument in sys.argv[1:] if argument != "--write"]:
        case ["run", crumple, folder]:
            study.run(Path(crumple).resolve(), Path(folder))
            sensitivity.run(Path(crumple).resolve(), Path(folder))
        case ["page", folder, path]:
            folder, path = Path(folder), Path(path)
            runs = [study.load(folder), study.load(folder / "repeated", study.SEED_OF_REPETITION)]
            verdicts = {section: suite_verdicts(folder, section) for section in ("S7", "S9")}
            page.check(path, runs, verdicts, is_written)
            sensitivity.check(path, folder, is_written)
        case ["bootstrap", folder]:
            bootstrap.main(Path(folder))
        case ["second", crumple]:
            second.main(Path(crumple).resolve(), is_written)
        case _:
            sys.exit(__doc__)
