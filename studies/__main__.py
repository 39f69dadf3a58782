"""Run the studies that are named, or all; options follow the names and go to each of them.

`python -m studies`; `python -m studies blind blind_acceptance --minutes 25 --workers 2`
"""

from __future__ import annotations

import importlib
import sys
from itertools import takewhile

STUDIES = ("blind", "blind_acceptance", "input_estimation", "physical", "refinement")


def main() -> None:
    """Run studies in turn with the arguments of the command line."""
    names = list(takewhile(lambda each: not each.startswith("-"), sys.argv[1:]))
    options = sys.argv[1 + len(names) :]
    unknown = sorted({*names} - {*STUDIES})
    if unknown or (options and not names):
        sys.exit(f"{__doc__}\nStudies: {', '.join(STUDIES)}")
    for name in names or STUDIES:
        print(f"\n== {name}", flush=True)
        sys.argv = [f"studies.{name}", *options]
        importlib.import_module(f"studies.{name}").main()


if __name__ == "__main__":
    main()
