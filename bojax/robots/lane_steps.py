"""The protocol of simulation steps that XLA calls as one operation for all lanes."""

import abc

from jaxtyping import Array, Float

from bojax.robots.models import MjModel


class LaneSteps(abc.ABC):
    """Several simulation steps of many robots of one model, under constant controls.

    Attributes:
        model: The compiled model.
        substeps: Number of simulation steps of a call.
    """

    model: MjModel
    substeps: int

    @abc.abstractmethod
    def __call__(
        self,
        qpos: Float[Array, "L Q"],
        qvel: Float[Array, "L V"],
        qacc_warmstart: Float[Array, "L V"],
        control: Float[Array, "L U"],
    ) -> tuple[Float[Array, "L Q"], Float[Array, "L V"], Float[Array, "L V"]]:
        """The state of every lane after the steps, in the order of `RobotState`; NaN if it is invalid."""
