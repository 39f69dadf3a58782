"""octave-control: n4sid, by SLICOT; measured inside Octave, data loaded before."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

from benchmarks.others.protocol import LONG, REPEATS, Data, Task, continuous, main
from benchmarks.timing import SHORTEST

SCRIPT = """
pkg load control
function kb = resident(name)
  text = fileread("/proc/self/status");
  found = regexp(text, [name ":\\\\s*(\\\\d+)"], "tokens");
  kb = str2double(found{1}{1});
end
function [model, info] = work(d, order, blocks)
  [model, ~, info] = n4sid(d, order, "s", blocks);
end
load(FILE);
d = iddata(y, u, dt);
file = fopen("/proc/self/clear_refs", "w"); fputs(file, "5"); fclose(file);
before = resident("VmRSS");
start = cputime(); [model, info] = work(d, order, blocks); times = cputime() - start;
peak = resident("VmHWM") - before;
if times <= LONG
  for k = 1:REPEATS
    start = cputime(); runs = 0; spent = 0;
    while spent < SHORTEST
      work(d, order, blocks); runs += 1; spent = cputime() - start;
    end
    times(k) = spent / runs;
  end
end
A = model.a;
about = ver("control");
save("-v6", ANSWER, "A", "times", "peak");
named = regexp(version("-blas"), "[A-Za-z]+ [0-9.]+", "match");
if isempty(named); named = {"reference BLAS"}; end
printf("%s (Octave %s, %s)", about.Version, version(), named{1});
"""


def n4sid(data: Data) -> dict[str, Any]:
    """A, B, C, D, initial state; the gain comes along in info."""
    import statistics
    import tempfile

    from scipy.io import loadmat, savemat

    with tempfile.TemporaryDirectory() as scratch:
        source, answer = Path(scratch) / "data.mat", Path(scratch) / "answer.mat"
        sizes = {"dt": data.dt, "order": data.order, "blocks": data.block_rows}
        savemat(source, {"u": data.inputs, "y": data.outputs, **sizes})
        script = SCRIPT
        for name, value in (("FILE", f'"{source}"'), ("ANSWER", f'"{answer}"')):
            script = script.replace(name, value)
        for name, number in (("LONG", LONG), ("REPEATS", REPEATS), ("SHORTEST", SHORTEST)):
            script = script.replace(name, str(number))
        version = _octave(script)
        found = loadmat(answer)
    times = found["times"].ravel().tolist()
    poles = continuous(found["A"], data.dt)
    return {
        "seconds": statistics.median(times),
        "runs": len(times),
        "megabytes": float(found["peak"].item()) / 1024,
        "poles": [[p.real, p.imag] for p in poles.tolist()],
        "version": version,
        "numpy": "",
    }


def _octave(script: str) -> str:
    """Run a script and return what it prints; its limits are those of this process."""
    done = subprocess.run(
        ["octave-cli", "--quiet", "--no-init-file", "--eval", script],
        capture_output=True,
        text=True,
        check=False,
        env=os.environ | _core(),
    )
    if done.returncode:
        print(done.stderr, file=sys.stderr)
        lines = [line for line in done.stderr.splitlines() if line.startswith("error")]
        raise RuntimeError(lines[0] if lines else f"octave ended with {done.returncode}")
    return done.stdout.strip()


def _core() -> dict[str, str]:
    """Name the processor to OpenBLAS: a distribution's may be older and take it for a slow one."""
    info = Path("/proc/cpuinfo")
    flags = info.read_text(encoding="utf-8") if info.exists() else ""
    for flag, core in (("avx512f", "SkylakeX"), ("avx2", "Haswell")):
        if flag in flags:
            return {"OPENBLAS_CORETYPE": os.environ.get("OPENBLAS_CORETYPE", core)}
    return {}


TASKS = tuple(
    Task(table, "n4sid: A, B, C, D, K, initial state", n4sid) for table in ("W1", "W2", "W3")
)
NAME = "octave-control"

if __name__ == "__main__":
    main(TASKS, NAME)
