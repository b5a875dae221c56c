"""Bayesian optimisation (Algorithm 1): ask where to evaluate, tell what was seen, or one compiled loop."""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Key, Scalar

from bojax.acquisition.functions import Acquisition
from bojax.acquisition.maximise import best_candidate, refine
from bojax.acquisition.scaling import standardise
from bojax.models.gaussian_process import GaussianProcess
from bojax.models.kernels import Kernel
from bojax.numerics.quasirandom import shifted_kronecker


class OptimisationState(eqx.Module):
    """What an optimisation knows.

    Attributes:
        key: What all steps draw from, each by its number.
        model: The observations: inputs mapped to [-1, 1]^D, values in the units of the objective.
        num_told: Evaluations told, missing ones included.
        num_missing: Evaluations that gave no finite value.
        was_missing: Whether the last one gave none.
    """

    key: Key[Array, ""]
    model: GaussianProcess
    num_told: Int[Array, ""]
    num_missing: Int[Array, ""]
    was_missing: Bool[Array, ""]


class BayesianOptimisation(eqx.Module):
    """Maximisation of a function over a box; to minimise one, maximise its negative (Algorithm 1).

    The process sees points mapped to [-1, 1]^D and values standardised at every step: the kernel, the noise
    and the acquisition are in these units. The acquisition is maximised over quasi-random points drawn anew
    at every step, then by gradient steps from the best of them; the thesis names DIRECT.

    A value or a point that is not finite counts as missing and teaches the model nothing. Since the model
    would ask for nearly the same point again, the point after it is quasi-random.

    Attributes:
        kernel: Covariance of the values.
        acquisition: Worth of a point.
        noise_variance: Noise of an observation, relative to the variance of the values observed.
        low: Lower corner of the box.
        high: Upper corner of the box.
        capacity: Most observations; what is told beyond is forgotten.
        num_candidates: Points among which the acquisition is maximised.
        num_initial: First observations, which are made at quasi-random points.
        refine_steps: Gradient steps from the best candidate; 0 for none.
    """

    kernel: Kernel
    acquisition: Acquisition
    noise_variance: Float[Array, ""]
    low: Float[Array, "D"]
    high: Float[Array, "D"]
    capacity: int = eqx.field(static=True)
    num_candidates: int = eqx.field(static=True, default=512)
    num_initial: int = eqx.field(static=True, default=4)
    refine_steps: int = eqx.field(static=True, default=20)

    def __check_init__(self):
        """Everything is counted from one, gradient steps from none."""
        least = {"capacity": 1, "num_candidates": 1, "num_initial": 1, "refine_steps": 0}
        for name, number in least.items():
            if getattr(self, name) < number:
                raise ValueError(f"{name}: {getattr(self, name)}; has to be at least {number}")

    def init(self, key: Key[Array, ""]) -> OptimisationState:
        """No observation yet."""
        return OptimisationState(
            key=key,
            model=GaussianProcess.prior(self.kernel, self.noise_variance, self.capacity, self.low.shape[0]),
            num_told=jnp.zeros((), jnp.int32),
            num_missing=jnp.zeros((), jnp.int32),
            was_missing=jnp.zeros((), bool),
        )

    def ask(self, state: OptimisationState) -> Float[Array, "D"]:
        """Where to evaluate next; the same state gives the same point."""
        model = state.model
        exists = _exists(model)
        values = standardise(model.y, exists)
        belief = eqx.tree_at(lambda model: model.y, model, values)
        # Without observations every point is as good: any finite threshold does.
        best = jnp.where(model.count > 0, jnp.max(jnp.where(exists, values, -jnp.inf)), 0.0)
        candidates = self._quasirandom(state, state.num_told + 1)
        choice = best_candidate(self.acquisition, belief, best, candidates, belief.whiten(candidates))
        point = candidates[choice]
        if self.refine_steps > 0:
            point = refine(self.acquisition, belief, best, point, self.refine_steps)
        initial = self._quasirandom(state, 0)[state.num_told % self.num_candidates]
        is_initial = (model.count < self.num_initial) | state.was_missing
        return self._from_unit(jnp.where(is_initial, initial, point))

    def tell(self, state: OptimisationState, x: Float[Array, "D"], y: Float[Array, ""]) -> OptimisationState:
        """The state after `y` was observed at `x`, which may be another point than the one asked for."""
        is_missing = ~(jnp.isfinite(y) & jnp.all(jnp.isfinite(x)))
        point, value = jnp.where(is_missing, 0.0, self._to_unit(x)), jnp.where(is_missing, 0.0, y)
        model = jax.tree.map(
            lambda old, new: jnp.where(is_missing, old, new), state.model, state.model.update(point, value)
        )
        return OptimisationState(
            key=state.key,
            model=model,
            num_told=state.num_told + 1,
            num_missing=state.num_missing + is_missing.astype(jnp.int32),
            was_missing=is_missing,
        )

    def best(self, state: OptimisationState) -> tuple[Float[Array, "D"], Float[Array, ""]]:
        """The point of the highest value observed, and that value; before any, the centre and -infinity."""
        values = jnp.where(_exists(state.model), state.model.y, -jnp.inf)
        return self._from_unit(state.model.x[jnp.argmax(values)]), jnp.max(values)

    def maximise(
        self,
        key: Key[Array, ""],
        function: Callable[[Key[Array, ""], Float[Array, "D"]], Scalar],
        num_iterations: int,
    ) -> tuple[OptimisationState, Float[Array, "T D"], Float[Array, "T"]]:
        """Ask, evaluate and tell, `num_iterations` times in one loop.

        Args:
            key: For the optimisation, and for the function.
            function: An observation at a point of the box, from a key for its noise and the point.
            num_iterations: Evaluations T; known when the loop is compiled.

        Returns:
            The state, and all points and values in their order, values that are missing included.

        Raises:
            ValueError: If the capacity is less than `num_iterations`.
        """
        if num_iterations > self.capacity:
            raise ValueError(f"num_iterations: {num_iterations}; the capacity is {self.capacity}")
        key_search, key_noise = jax.random.split(key)

        def step(state: OptimisationState, index: Int[Array, ""]):
            x = self.ask(state)
            y = function(jax.random.fold_in(key_noise, index), x)
            return self.tell(state, x, y), (x, y)

        state, (xs, ys) = jax.lax.scan(step, self.init(key_search), jnp.arange(num_iterations))
        return state, xs, ys

    def _quasirandom(self, state: OptimisationState, stream: int | Int[Array, ""]) -> Float[Array, "C D"]:
        key = jax.random.fold_in(state.key, stream)
        return shifted_kronecker(key, self.num_candidates, self.low.shape[0], self.low.dtype)

    def _from_unit(self, point: Float[Array, "D"]) -> Float[Array, "D"]:
        # A weighted sum of the corners stays between them, as their difference times a number might not.
        weight = 0.5 * (point + 1.0)
        return (1.0 - weight) * self.low + weight * self.high

    def _to_unit(self, x: Float[Array, "D"]) -> Float[Array, "D"]:
        return 2.0 * (x - self.low) / (self.high - self.low) - 1.0


def _exists(model: GaussianProcess) -> Bool[Array, "N"]:
    return jnp.arange(model.y.shape[0], dtype=model.count.dtype) < model.count
