"""What the benchmarks share: interleaved rounds, the machine in words, and where results are kept."""

import datetime
import json
import os
import platform
import statistics
import subprocess
import time
from pathlib import Path

ROOT = Path(__file__).parent.parent.parent


def interleave(tasks, rounds, prepare=None):
    """Seconds of each task in each round: {name: [seconds]}.

    All tasks run once before the first round. Rounds visit every task, so that a change of the machine's
    speed meets all of them. ``tasks`` maps a name to a function; ``prepare(name)``, which is not timed,
    runs before each call.
    """
    times = {name: [] for name in tasks}
    for number in range(rounds + 1):
        for name, task in tasks.items():
            if prepare:
                prepare(name)
            start = time.perf_counter()
            task()
            elapsed = time.perf_counter() - start
            if number > 0:
                times[name].append(elapsed)
    return times


def summary(times):
    """Median and quartiles of one task's times."""
    if len(times) == 1:
        return {"median": times[0], "quartiles": [times[0], times[0]], "rounds": 1}
    low, median, high = statistics.quantiles(times, n=4, method="inclusive")
    return {"median": median, "quartiles": [low, high], "rounds": len(times)}


def ratio(times, reference):
    """Median of the ratio of two tasks, taken round by round."""
    return statistics.median(a / b for a, b in zip(times, reference))


def machine():
    """Where and when: CPU, cores, load, versions."""
    model = platform.processor()
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.exists():
        fields = dict(
            (part.strip() for part in line.split(":", 1))
            for line in cpuinfo.read_text().split("\n\n")[0].splitlines()
            if ":" in line
        )
        model = f"{fields.get('model name')} (family {fields.get('cpu family')}, model {fields.get('model')})"
    commit = subprocess.run(
        ["git", "rev-parse", "--short", "HEAD"], cwd=ROOT, capture_output=True, text=True
    ).stdout.strip()
    return {
        "date": datetime.datetime.now().astimezone().isoformat(timespec="minutes"),
        "cpu": model,
        "cores": os.cpu_count(),
        "load": [round(x, 1) for x in os.getloadavg()],
        "python": platform.python_version(),
        "commit": commit,
    }


def keep(path, result):
    """Writes ``result`` as JSON, for a file of docs/notes/bench."""
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(result, indent=1) + "\n")
    print(f"written: {path}")
