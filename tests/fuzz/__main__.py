"""`python -m tests.fuzz --files 200 --inputs 20000 --seed 0`: what came out, and exit code 1 where something failed."""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

from tests.fuzz.inputs import READERS
from tests.fuzz.reading import fuzz_reader


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("--files", type=int, default=200, help="hostile files that are sent to a service")
    parser.add_argument("--inputs", type=int, default=20_000, help="generated inputs for each reader")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--readers", nargs="*", default=list(READERS), choices=list(READERS))
    parser.add_argument("--bombs", action="store_true", help="send only what is huge inside or endless")
    wanted = parser.parse_args()
    failures = []
    if wanted.files:
        from tests.fuzz.sending import BOMBS, MAKERS, send_files  # loads the whole service, which no reader needs

        with tempfile.TemporaryDirectory() as folder:
            makers = BOMBS if wanted.bombs else MAKERS
            sent = send_files(wanted.files, wanted.seed, Path(folder), makers=makers)
        print(sent.table(), flush=True)
        failures += sent.failures
    for reader in wanted.readers if wanted.inputs else []:
        found = fuzz_reader(reader, wanted.inputs, wanted.seed)
        print(found.line(), flush=True)
        failures += found.failures
    for failure in failures:
        print(failure)
    print(f"{len(failures)} failure(s)")
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
