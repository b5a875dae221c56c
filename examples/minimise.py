"""Find the best settings of any Python function: numbers, integers, choices, and ranges that span decades."""

import bojax


def error(rate: float, depth: int, kind: str) -> float:
    """Stands for an expensive function, such as the validation error of a model."""
    offset = {"rbf": 0.3, "matern": 0.0, "linear": 1.0}[kind]
    return (rate / 0.02 - 1.0) ** 2 / (1.0 + rate / 0.02) + 0.1 * abs(depth - 5) + offset


space = {"rate": (1e-5, 1.0, "log"), "depth": (1, 8), "kind": ["rbf", "matern", "linear"]}
found = bojax.minimise(error, space, budget=30)
print("best:", found.best, "with", found.value)
print(found.table.num_rows, "evaluations,", found.num_failed, "failed")
found.plot().figure.savefig("minimise.png")
