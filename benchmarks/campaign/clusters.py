"""Odd settings of clusters: refused in one line, or a script that Slurm reads as it was meant."""

import os
import random
import subprocess

import yaml

from benchmarks.campaign.case import Outcome, fault_of
from benchmarks.campaign.process import cli, run, scratch
from benchmarks.campaign.snippets import odd, shown
from benchmarks.campaign.workloads import WORKLOADS

_KEYS = {
    "slurm": "tasks partition account time gpus_per_task cpus_per_task memory options setup".split(),
    "ray": ["address", "workers", "cpus_per_worker"],
}
_TEXTS = ("a b", "x\n#SBATCH --exclusive", "x\ny", "x\ry", "\x1b[31m", "")
_TEXTS += ("$(touch planted)", "`touch planted`", "'; touch planted")

_SBATCH = '#!/bin/sh\ncat > "$SUBMITTED/script"\necho 1\n'


def check(seed: int) -> Outcome:
    """Launch a sweep with odd settings; `sbatch` keeps the script that it is given."""
    draw = random.Random(f"clusters {seed}")
    with scratch() as place:
        launcher = draw.choice(["slurm", "slurm", "ray"])
        key = draw.choice(_KEYS[launcher])
        if draw.random() < 0.5:
            text, _ = odd(draw)
        else:
            value = draw.choice(_TEXTS)
            value = [value] if key in ("options", "setup") else value
            text = yaml.safe_dump(value, default_flow_style=True).strip()
        if launcher == "ray" and key != "address":
            key = f"address: 127.0.0.1:1\n{key}"  # where nothing answers: no cluster is started
        (place / "cluster.yaml").write_text(f"{key}: {text}\n")
        for tool in ("sbatch", "squeue", "scancel", "scontrol"):
            (place / tool).write_text(_SBATCH if tool == "sbatch" else "#!/bin/sh\n")
            (place / tool).chmod(0o755)
        name = draw.choice(["out", "out put", "out'put", "out\nput", "out\n#SBATCH --exclusive"])

        def start() -> int:
            os.environ.update(PATH=f"{place}:{os.environ['PATH']}", SUBMITTED=str(place))
            words = [*WORKLOADS["shared"].words, "--launcher", launcher, "--cluster", "cluster.yaml"]
            return cli(*words, "--out", name)

        ended = run(start, place)
        tried = f"{launcher}, {key}: {shown(text)}, --out {name!r}"
        fault = fault_of(ended, (0, 2) if launcher == "slurm" else (1, 2))
        script = place / "script"
        if not fault and ended.code and (script.exists() or any(place.rglob("*.parquet"))):
            fault = "refused, and submitted or written"
        if not fault and script.exists():
            fault = _misread(script.read_text(), place)
        return Outcome(tried, "something of the file has run" if (place / "planted").exists() else fault)


def _misread(script: str, place) -> str:
    """Why Slurm or the shell would not read the script as it was meant; empty if they would."""
    lines = script.splitlines()
    options = [number for number, line in enumerate(lines) if line.startswith("#SBATCH ")]
    if any("--exclusive" in lines[number] for number in options):
        return "an option that was not given"
    if options != list(range(options[0], options[0] + len(options))):
        return "options are not together"
    done = subprocess.run(["bash", "-n"], input=script, cwd=place, capture_output=True, text=True)
    return f"the shell refuses the script: {done.stderr[-200:]}" if done.returncode else ""
