"""Every built-in schema class: importing this module registers them all."""

from bojax.config import (
    claims,
    envs,
    experiments,
    fields,
    learners,
    models,
    motions,
    objectives,
    physics,
    planners,
    problems,
    schedules,
    tabular,
    vehicles,
)
from bojax.config.component import Component, registry

__all__ = [
    "PROTOCOLS",
    "ROLES",
    "claims",
    "envs",
    "experiments",
    "fields",
    "kinds",
    "learners",
    "models",
    "motions",
    "objectives",
    "physics",
    "planners",
    "problems",
    "schedules",
    "tabular",
    "vehicles",
]

ROLES = {
    "experiment": "experiments",
    "problem": "problems",
    "env": "environments",
    "planner": "planners",
    "learner": "learners",
    "schedule": "schedules of exploration",
    "exploration-reward": "exploration rewards",
    "features": "features of states and actions",
    "motions": "families of trajectories",
    "field": "fields",
    "objective": "worths of a sample of a field",
    "kernel": "kernels",
    "mean": "prior means",
    "acquisition": "acquisition functions",
    "vehicle": "robots that drive planned paths",
    "sensor": "sensors",
    "physics": "engines of physics",
}
"""The roles that a user can fill, with their plurals, in the order of lists."""

PROTOCOLS = {
    "experiment": "bojax.experiments.base:Experiment",
    "problem": "bojax.problems.base:Problem",
    "planner": "bojax.planning.base:Planner",
    "env": "bojax.envs.base:Env",
    "learner": "bojax.learning.base:Learner",
    "schedule": "bojax.learning.schedules:Schedule",
    "exploration-reward": "bojax.learning.exploration_rewards:ExplorationReward",
    "field": "bojax.fields.base:Field",
    "objective": "bojax.problems.objectives:FieldObjective",
    "kernel": "bojax.models.kernels:Kernel",
    "mean": "bojax.models.means:Mean",
    "acquisition": "bojax.acquisition.functions:Acquisition",
    "vehicle": "bojax.problems.vehicles.base:Vehicle",
    "sensor": "bojax.problems.sensors:Sensor",
}
"""Base class of each role, whose abstract methods a user's class has to provide."""


def kinds(role: str) -> dict[str, type[Component]]:
    """The built-in schema classes of a role, by kind."""
    return {kind: schema for kind, schema in registry.get(role, {}).items() if issubclass(schema, Component)}
