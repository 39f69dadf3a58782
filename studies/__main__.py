"""Run every study in turn, passing the arguments (such as --seeds 10) on."""

from __future__ import annotations

import importlib
import pkgutil

import studies


def main() -> None:
    """Run all studies with the arguments of the command line."""
    for module in sorted(pkgutil.iter_modules(studies.__path__), key=lambda each: each.name):
        if not module.name.startswith("_"):
            print(f"\n== {module.name}", flush=True)
            importlib.import_module(f"studies.{module.name}").main()


if __name__ == "__main__":
    main()
