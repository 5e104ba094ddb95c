"""Collects the recordings of OpenACC's ZalaZONE campaign that `files.sha256` lists, and checks each of them.

    python3 examples/studies/openacc/fetch.py OUT                   # downloads the files (120 MB)
    python3 examples/studies/openacc/fetch.py OUT --from FOLDER     # takes them from a folder, or from its subfolders

Source: European Commission, Joint Research Centre: Open ACC Database, doi:10.2905/JRC.KMH3D00; Makridis et al.,
Transportation Research Part C 125 (2021) 103047. The repository thibault-charlottin/ACC-platoon-fuel-consumption on
GitHub has copies in folders by distance setting, and states no licence. Two public repositories that use the database
name its licence as CC BY 4.0; the entry of the Joint Research Centre's catalogue was not read. crumple contains none of
the recordings.

The list has the 50 files that are smaller than 4 MiB. The repository has 20 larger ones, which could not be downloaded
where the list was made: dynamic parts 3, 9, 11, 13, 15, 17 and 24; handling parts 4, 6, 7, 8, 13, 21, 27, 28, 29, 30,
32, 42 and 43.
"""

import argparse
import hashlib
import sys
import urllib.parse
import urllib.request
from pathlib import Path

LIST = Path(__file__).with_name("files.sha256")
REPOSITORY = "https://raw.githubusercontent.com/thibault-charlottin/ACC-platoon-fuel-consumption"
SOURCE = f"{REPOSITORY}/8781ec31a976113210a9809b98345c76594c3896/data/OpenACC_data"
MAX_BYTES = 64 << 20


def read_list(path):
    """Returns digest and path of each file of a list."""
    return [tuple(line.split("  ", 1)) for line in path.read_text().splitlines() if line]


def read_file(path, digest, folder, source):
    """Returns the bytes of a file from a folder, or else from the source; None if it is missing.

    Of several files with its name in the folder, it takes the one with the digest.
    """
    if folder:
        contents = [file.read_bytes() for file in sorted(folder.rglob(Path(path).name))]
        matching = [content for content in contents if hashlib.sha256(content).hexdigest() == digest]
        return next(iter(matching + contents), None)
    try:
        with urllib.request.urlopen(f"{source}/{urllib.parse.quote(path)}", timeout=60) as answer:
            return answer.read(MAX_BYTES)
    except OSError as error:
        print(f"{path}: {error}", file=sys.stderr)
        return None


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path, help="folder for the files")
    parser.add_argument("--from", dest="folder", type=Path, help="folder that has the files")
    parser.add_argument("--source", default=SOURCE, help="address of the folder of the files")
    parser.add_argument("--list", type=Path, default=LIST, help="list of digests and paths")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    entries = read_list(arguments.list)
    failed = 0
    for digest, path in entries:
        content = read_file(path, digest, arguments.folder, arguments.source)
        if content is None:
            problem = "missing"
        elif hashlib.sha256(content).hexdigest() != digest:
            problem = "differs from the listed file"
        else:
            (arguments.out / Path(path).name).write_bytes(content)
            continue
        failed += 1
        print(f"{path}: {problem}", file=sys.stderr)
    print(f"{len(entries) - failed} of {len(entries)} files are in {arguments.out}")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
