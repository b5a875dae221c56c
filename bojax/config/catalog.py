"""Every built-in schema class: importing this module registers them all."""

from bojax.config import claims, experiments, fields, models, motions, objectives, planners, problems
from bojax.config.component import Component, registry

__all__ = [
    "PROTOCOLS",
    "ROLES",
    "claims",
    "experiments",
    "fields",
    "kinds",
    "models",
    "motions",
    "objectives",
    "planners",
    "problems",
]

ROLES = {
    "experiment": "experiments",
    "problem": "problems",
    "env": "environments",
    "planner": "planners",
    "learner": "learners",
    "motions": "families of trajectories",
    "field": "fields",
    "objective": "worths of a sample of a field",
    "kernel": "kernels",
    "mean": "prior means",
    "acquisition": "acquisition functions",
}
"""The roles that a user can fill, with their plurals, in the order of lists."""

PROTOCOLS = {
    "experiment": "bojax.experiments.base:Experiment",
    "problem": "bojax.problems.base:Problem",
    "planner": "bojax.planning.base:Planner",
    "field": "bojax.fields.base:Field",
    "objective": "bojax.problems.objectives:FieldObjective",
    "kernel": "bojax.models.kernels:Kernel",
    "mean": "bojax.models.means:Mean",
    "acquisition": "bojax.acquisition.functions:Acquisition",
}
"""Base class of each role, whose abstract methods a user's class has to provide."""


def kinds(role: str) -> dict[str, type[Component]]:
    """The built-in schema classes of a role, by kind."""
    return {kind: schema for kind, schema in registry.get(role, {}).items() if issubclass(schema, Component)}
