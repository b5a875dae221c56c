"""Settings of the planners."""

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from bojax.acquisition.settings import UpperConfidenceBound
from bojax.config.component import Component, Slot
from bojax.config.limits import LEVELS
from bojax.models.settings import RBF
from bojax.motions.settings import (
    ContinuousMotions,
    CubicCurves,
    DiscreteMotions,
    KernelTrajectories,
    Splines,
)
from bojax.problems.settings import Gradient, Uncertainty


class PlannerSettings(Component, frozen=True):
    """A planner."""

    role: ClassVar[str] = "planner"
    plural: ClassVar[str] = "planners"
    protocol: ClassVar[str] = "bojax.planning.base:Planner"


_Objective = Annotated[
    Component | None,
    Slot("objective", optional=True),
    Field(description="objective to maximise; null for the problem's task"),
]
_Family = Field(description="family of trajectories")
_Discrete = Annotated[Component, Slot("motions", only=DiscreteMotions), _Family]
_Continuous = Annotated[Component, Slot("motions", only=ContinuousMotions), _Family]


class _TreeSearch(PlannerSettings, frozen=True):
    iterations: int = Field(default=300, ge=1, description="simulations per plan")
    depth: Annotated[int, LEVELS.bound()] = Field(default=3, ge=1, description="actions up to the horizon")
    exploration: float = Field(
        default=300.0,
        ge=0,
        description="weight of the exploration bonus (kappa_MC of 4.1), in units of the return",
    )
    discount: float = Field(default=1.0, gt=0, le=1, description="discount per step")
    objective: _Objective = None


class _ContinuousBeliefTreeSearch(_TreeSearch, frozen=True):
    target: ClassVar[str] = "bojax.planning.cbts:ContinuousBeliefTreeSearch"

    max_actions: int = Field(default=20, ge=1, description="largest number of actions of a node (A_max)")
    kernel: Annotated[Component, Slot("kernel")] = Field(
        default=RBF(), description="kernel of a node's Gaussian process, from [-1, 1]^D to rewards"
    )
    acquisition: Annotated[Component, Slot("acquisition")] = Field(
        default=UpperConfidenceBound(kappa=100.0), description="acquisition that new actions maximise"
    )
    convergence: float = Field(
        default=0.0,
        ge=0,
        description="distance of successive actions that ends new actions at a node; 0: never",
    )
    scaling: Literal["standardise", "rank", "none"] = Field(
        default="standardise",
        description="scaling of a node's rewards for its Gaussian process: to mean 0 and variance 1, to "
        "their ranks spread evenly over [-1, 1], or none",
    )
    num_initial: int = Field(default=2, ge=1, description="number of first actions of a node that are random")
    noise_variance: float = Field(
        default=0.01, gt=0, description="noise variance of a node's Gaussian process, of scaled rewards"
    )
    num_candidates: int = Field(
        default=128, ge=1, description="number of quasi-random candidates of new actions, drawn for each plan"
    )
    refine_steps: int = Field(default=0, ge=0, description="number of gradient steps from the best candidate")


class KCBTS(_ContinuousBeliefTreeSearch, frozen=True):
    """Continuous belief tree search on kernel trajectories (thesis, Algorithms 3-4, Section 4.6)."""

    kind: Literal["kcbts"] = "kcbts"
    motions: _Continuous = KernelTrajectories()


class CBTS(_ContinuousBeliefTreeSearch, frozen=True):
    """Continuous belief tree search on cubic curves (thesis, Algorithm 3)."""

    kind: Literal["cbts"] = "cbts"
    motions: _Continuous = CubicCurves()


class _DiscreteTreeSearch(_TreeSearch, frozen=True):
    target: ClassVar[str] = "bojax.planning.discrete:DiscreteTreeSearch"

    motions: _Discrete = Splines()


class SBO(_DiscreteTreeSearch, frozen=True):
    """Monte Carlo tree search over a discrete set of trajectories (thesis, Algorithm 2)."""

    kind: Literal["sbo"] = "sbo"


class BOPOMDP(_DiscreteTreeSearch, frozen=True):
    """Tree search over a discrete set that samples the steep areas of a field (thesis, Algorithm 2)."""

    kind: Literal["bo-pomdp"] = "bo-pomdp"
    objective: _Objective = Gradient()


class _MyopicPlanner(PlannerSettings, frozen=True):
    target: ClassVar[str] = "bojax.planning.myopic:MyopicPlanner"

    motions: _Discrete = Splines()
    objective: _Objective = None


class Myopic(_MyopicPlanner, frozen=True):
    """The best next trajectory of a discrete set, by exhaustive search (thesis, Section 3.3.1)."""

    kind: Literal["myopic"] = "myopic"


class Explorer(_MyopicPlanner, frozen=True):
    """The next trajectory of a discrete set with the largest uncertainty (thesis, Section 3.5.1)."""

    kind: Literal["explorer"] = "explorer"
    objective: _Objective = Uncertainty()


class GpsAbt(_TreeSearch, frozen=True):
    """Tree search whose nodes refine their actions by generalised pattern search (ABT toolkit)."""

    target: ClassVar[str] = "bojax.planning.gps_abt:PatternSearch"
    kind: Literal["gps-abt"] = "gps-abt"
    exploration: float = Field(
        default=100.0,
        ge=0,
        description="weight of the exploration bonus (root of the toolkit's C), as the return",
    )
    growth: float = Field(
        default=5.0, gt=1, description="growth k: a node of N visits has up to ln N / ln k levels of stencils"
    )
    min_visits: float = Field(
        default=2.0, ge=0, description="visits of every best point on the way before a stencil is refined"
    )
    min_radius: float = Field(default=0.1, gt=0, description="largest radius of stencils not refined")
    initial_radius: float = Field(default=1.0, gt=0, description="initial radius; the box is [-1, 1]")
    max_levels: int = Field(default=6, ge=1, description="largest number of stencils on a descent")
    num_rollout_paths: int = Field(
        default=128, ge=1, description="number of random paths that rollouts draw from, new for each plan"
    )
    heuristic: Literal["rollout", "zero"] = Field(
        default="rollout", description="value after a new action: of a random rollout to the horizon, or zero"
    )
    motions: _Continuous = KernelTrajectories()


class Random(PlannerSettings, frozen=True):
    """Trajectories drawn at random."""

    target: ClassVar[str] = "bojax.planning.random:RandomPlanner"
    kind: Literal["random"] = "random"
    motions: Annotated[Component, Slot("motions"), _Family] = Splines()
