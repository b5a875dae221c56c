"""A sweep from Python: two settings of a learner on the chain, and the best of them on new runs."""

import bojax

sweep = {
    "base": {
        "experiment": "learning",
        "env": {"kind": "chain", "length": 8, "max_length": 8, "max_steps": 100},
        "learner": "additive",
        "episodes": 30,
        "stop": "first-success",
    },
    "axes": {"learner.learning_rate": [0.1, 0.5], "learner.discount": [0.5, 0.9, 0.99]},
}
results = bojax.sweep(sweep, runs=20)
means = results.runs.group_by("learner.learning_rate").aggregate([("steps_to_goal", "mean")])
print("steps to the goal:", means["steps_to_goal_mean"].to_pylist())
results.show("heat-map").figure.savefig("heat_map.png")

fresh = bojax.run(results.best(), runs=50)
print("success of the best:", sum(fresh.runs["success"].to_pylist()) / 50)
