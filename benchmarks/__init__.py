"""Benchmarks: each bench_*.py measures one claim; `python -m benchmarks` runs them all."""
