"""Does what a page of the book shows: `tutorial.py PAGE FOLDER`.

A block whose first line says `file=NAME` is written to that file; each line that begins with `$ ` in a block of `console` is run. What a
command ends with must be 0, and of the page nothing may be left out: a block of another kind is an error.
"""

import re
import subprocess
import sys
from pathlib import Path


def main(page, folder):
    """Writes and runs all of it."""
    blocks = re.findall(r"^```(\w+)(?: file=(\S+))?\n(.*?)^```$", Path(page).read_text(), re.MULTILINE | re.DOTALL)
    done = 0
    for kind, name, text in blocks:
        if name:
            Path(folder, name).write_text(text)
        elif kind == "console":
            for command in (line[2:] for line in text.splitlines() if line.startswith("$ ")):
                print(f"$ {command}", flush=True)
                ended = subprocess.run(["bash", "-c", f"set -euo pipefail; {command}"], cwd=folder, check=False)
                if ended.returncode:
                    sys.exit(f"{page}: `{command}` ended with {ended.returncode}")
                done += 1
        else:
            sys.exit(f"{page}: a block of {kind} is neither a file nor a command")
    print(f"{page}: {done} commands, each ended with 0")


if __name__ == "__main__":
    main(*sys.argv[1:])
