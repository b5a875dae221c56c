"""Settings of the experiments."""

from typing import Annotated, ClassVar, Literal

import pydantic
from pydantic import Field
from typing_extensions import override

from bojax.config.component import Component, External, Slot, registry
from bojax.learning.settings import Constant, Exploit, UntilTarget
from bojax.motions.settings import KernelTrajectories
from bojax.planning.settings import KCBTS, BeliefPlannerSettings, RouteSettings
from bojax.problems.pomdp.settings import StateProblemSettings
from bojax.problems.settings import FieldProblem, Parking


class ExperimentSettings(Component, frozen=True):
    """An experiment: the definition of one run."""

    role: ClassVar[str] = "experiment"
    plural: ClassVar[str] = "experiments"
    protocol: ClassVar[str] = "bojax.experiments.base:Experiment"

    dtype: Literal["float64", "float32"] = Field(default="float64", description="floating-point precision")


class Planning(ExperimentSettings, frozen=True):
    """One episode of a planner on a problem."""

    target: ClassVar[str] = "bojax.experiments.planning:PlanningEpisode"
    kind: Literal["planning"] = "planning"
    problem: Annotated[Component, Slot("problem")] = Field(default=Parking(), description="planning problem")
    planner: Annotated[Component, Slot("planner")] = Field(
        default=KCBTS(), description="planner, which knows the problem's model and observes the world"
    )

    @pydantic.model_validator(mode="after")
    def _planner_fits_problem(self) -> "Planning":
        is_known = not isinstance(self.problem, External) and not isinstance(self.planner, External)
        has_particles = isinstance(self.problem, StateProblemSettings)
        if is_known and has_particles != isinstance(self.planner, BeliefPlannerSettings):
            planners = registry["planner"].items()
            fitting = [n for n, s in planners if issubclass(s, BeliefPlannerSettings) == has_particles]
            raise ValueError(
                f"planner: got {self.planner.label}; the actions of {self.problem.label} are "
                f"{'vectors' if has_particles else 'paths'}; allowed: {', '.join(fitting)}"
            )
        if isinstance(self.problem, FieldProblem) and self.problem.field is None:
            raise ValueError(
                "problem.field: got null; allowed: a true field, which a run samples, such as {kind: grid, "
                "file: depth.tif}; bojax survey and bojax.Mission plan without one"
            )
        has_no_field = not isinstance(self.problem, External | FieldProblem)
        if has_no_field and isinstance(self.planner, RouteSettings):
            raise ValueError(
                f"planner: got {self.planner.label}, which follows a route on a field, and "
                f"{self.problem.label} has no field; allowed: another planner"
            )
        if has_no_field and getattr(self.planner, "objective", None) is not None:
            raise ValueError(
                f"planner.objective: {self.planner.label} maximises an objective on a field, and "
                f"{self.problem.label} has no field: set planner.objective to null, or choose another planner"
            )
        return self

    @property
    @override
    def label(self) -> str:
        return self.planner.label


class Learning(ExperimentSettings, frozen=True):
    """Episodes of a learner in an environment, with test episodes in between (thesis, Algorithm 5)."""

    target: ClassVar[str] = "bojax.experiments.learning:LearningRun"
    kind: Literal["learning"] = "learning"
    dtype: Literal["float64", "float32"] = Field(default="float32", description="floating-point precision")
    env: Annotated[Component, Slot("env")] = Field(description="environment to learn in")
    learner: Annotated[Component, Slot("learner")] = Field(description="learner")
    schedule: Annotated[Component, Slot("schedule")] = Field(
        default=Constant(), description="schedule of exploration over the training episodes"
    )
    episodes: int = Field(default=100, ge=1, description="number of training episodes")
    action_repeat: int = Field(
        default=1,
        ge=1,
        description="number of steps for which every action is repeated; the learner learns from each step",
    )
    starts: Literal["per-episode", "per-run"] = Field(
        default="per-episode",
        description="every episode draws its initial state, or all those of a run share one",
    )
    stop: Literal["never", "first-success", "target"] = Field(
        default="never", description="early end of a run: at its first success, or above target_return"
    )
    tests: int = Field(default=0, ge=0, description="number of tests after each episode; they do not explore")
    tests_learn: Literal["no", "exploiting", "exploring"] = Field(
        default="no",
        description="whether the learner keeps learning in its tests, which do not explore: no; from rewards "
        "alone, as in pure exploitation; or with the exploration rewards of training",
    )
    target_return: float | None = Field(
        default=None, description="return that all tests after an episode have to exceed; null for none"
    )
    map_episodes: tuple[Annotated[int, Field(ge=1)], ...] = Field(
        default=(), strict=False, description="training episodes after which maps of Q and U are saved"
    )
    map_resolution: int = Field(default=48, ge=2, description="number of cells of a map along each dimension")
    saved: str | None = Field(
        default=None, description="folder of saved learners to start from; null for none"
    )
    saved_run: int = Field(default=0, ge=0, description="run whose learner is taken from saved")

    @pydantic.model_validator(mode="after")
    def _target_is_tested(self) -> "Learning":
        needs = self.stop == "target" or isinstance(self.schedule, UntilTarget)
        if needs and self.target_return is None:
            raise ValueError(
                "target_return: got null; allowed: a number, if stop is target or schedule is until-target"
            )
        if self.target_return is not None and not self.tests:
            raise ValueError("tests: got 0; allowed: >= 1 with a target_return, which tests have to exceed")
        if self.saved is not None and not isinstance(self.schedule, Exploit):
            raise ValueError(
                f"schedule: got {self.schedule.kind}; allowed: exploit, since a saved learner is not trained"
            )
        return self

    @property
    @override
    def label(self) -> str:
        return self.learner.label


class Trajectories(ExperimentSettings, frozen=True):
    """A gallery of the trajectories of one family, all from one pose (thesis, Fig. 4.2)."""

    target: ClassVar[str] = "bojax.experiments.trajectories:TrajectoryGallery"
    kind: Literal["trajectories"] = "trajectories"
    motions: Annotated[Component, Slot("motions")] = Field(
        default=KernelTrajectories(), description="family of trajectories"
    )
    levels: int = Field(
        default=3, ge=1, description="number of evenly spaced values of each parameter of a continuous family"
    )

    @property
    @override
    def label(self) -> str:
        return self.motions.label
