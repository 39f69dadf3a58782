"""Run every benchmarks/bench_*.py in turn, passing the arguments (such as --quick) on."""

from __future__ import annotations

import importlib
import pkgutil
import sys

import benchmarks


def main(arguments: list[str] | None = None) -> None:
    """Run all benchmarks with `arguments`, by default those of the command line."""
    arguments = sys.argv[1:] if arguments is None else arguments
    names = sorted(module.name for module in pkgutil.iter_modules(benchmarks.__path__))
    for name in names:
        if name.startswith("bench_"):
            print(f"\n== {name}", flush=True)
            importlib.import_module(f"benchmarks.{name}").main(arguments)


if __name__ == "__main__":
    main()
