#!/bin/sh
# Tunes every planner of Fig. 4.6 under the printed rule of parking, with equal budgets, and runs the figure with the
# best settings of each.
#
#     benchmarks/parking_printed.sh OUT [ROUNDS [POINTS [RUNS [FRESH]]]]
#
# Each planner has ROUNDS x POINTS x RUNS runs of its search, on a seed of its own, and FRESH runs of each of its best
# three settings on another seed. OUT/planners.yaml has the best settings. OUT/fig-4.6.yaml is Fig. 4.6 with them, and
# OUT/fig-4.6 its results: FRESH runs of each variant, on the seed of the published sweep, which no search has seen.
# The variants with a relaxed rule have the settings that are best under the printed one: they differ in the rule alone.
set -eu
OUT=$1 ROUNDS=${2:-12} POINTS=${3:-16} RUNS=${4:-200} FRESH=${5:-1000}
PYTHON=${PYTHON:-.venv/bin/python}
KERNEL="planner.motions.first_angle=0.3:1.57 planner.motions.turn_angle=0.6:1.6
    planner.motions.space_lengthscale=0.25:1.5:log planner.motions.time_lengthscale=0.5:1.5"

# tune NAME SEED SETTING...
tune() {
    name=$1 seed=$2
    shift 2
    "$PYTHON" -m bojax tune parking problem.rule=printed "$@" --budget $((ROUNDS * POINTS * RUNS)) --batch "$POINTS" \
        --runs "$RUNS" --seed "$seed" --confirm "$FRESH" --out "$OUT/tune/$name" --resume
}

mkdir -p "$OUT"
# shellcheck disable=SC2086 # the settings of the trajectories are several words
tune kcbts 100 planner=kcbts $KERNEL planner.acquisition.kappa=1:300:log planner.exploration=10:3000:log \
    planner.kernel.lengthscale=0.2:1.2
seed=200
for actions in 5 9 17; do
    tune "sbo-$actions" $seed planner=sbo "planner.motions.actions=$actions" planner.exploration=1:3000:log \
        planner.discount=0.9:1
    seed=$((seed + 100))
done
# shellcheck disable=SC2086
tune gps-abt 500 planner=gps-abt $KERNEL planner.exploration=10:1000:log planner.growth=2:5 planner.min_visits=1:4 \
    planner.min_radius=0.05:0.2 planner.initial_radius=0.3:1

"$PYTHON" - "$OUT" <<'END'
import sys
from pathlib import Path

import yaml

out = Path(sys.argv[1])
names = ("kcbts", "sbo-5", "sbo-9", "sbo-17", "gps-abt")
best = {name: yaml.safe_load((out / "tune" / name / "best.yaml").read_text())["planner"] for name in names}
(out / "planners.yaml").write_text(yaml.safe_dump(best, sort_keys=False))
sweep = yaml.safe_load(Path("sweeps/fig-4.6.yaml").read_text())
planners = sweep["axes"]["planner"]
for variant in planners:
    tuned = best.get("sbo-17" if variant == "sbo" else variant)
    if tuned is None and variant.split("-", 1)[0] in ("kcbts", "sbo"):
        tuned = best["kcbts" if variant.startswith("kcbts") else "sbo-17"]
    planners[variant] = tuned or planners[variant]
(out / "fig-4.6.yaml").write_text(yaml.safe_dump(sweep, sort_keys=False))
END
"$PYTHON" -m bojax sweep "$OUT/fig-4.6.yaml" --runs "$FRESH" --out "$OUT/fig-4.6" --resume
