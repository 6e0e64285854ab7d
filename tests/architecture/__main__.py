"""Count the package's files and lines of code: ``python -m tests.architecture``."""

from collections import Counter
from pathlib import PurePath

from tests.architecture.test_sizes import code


def main():
    files, lines = Counter(), Counter()
    for name, held in code().items():
        folder = PurePath(name).parts[0] if "/" in name else "(top)"
        files[folder] += 1
        lines[folder] += len(held)
    for folder in sorted(files):
        print(f"{folder:12}{files[folder]:4} files{lines[folder]:7,} lines")
    print(f"{'all':12}{files.total():4} files{lines.total():7,} lines")


if __name__ == "__main__":
    main()
