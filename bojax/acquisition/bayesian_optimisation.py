"""Bayesian optimisation (Algorithm 1): ask where to evaluate, tell what was seen, or one compiled loop."""

from collections.abc import Callable, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Key, Scalar

from bojax.acquisition.functions import Acquisition
from bojax.acquisition.maximise import best_candidate, refine
from bojax.acquisition.scaling import standardise
from bojax.models.checks import (
    as_numbers,
    check_count,
    check_finite,
    check_key,
    check_kind,
    check_number,
    check_positive,
    check_takes,
    is_known,
)
from bojax.models.evidence import log_normal_prior, relearn
from bojax.models.gaussian_process import GaussianProcess
from bojax.models.kernels import Kernel
from bojax.numerics.quasirandom import shifted_kronecker

PRIOR_SPREAD = 1.5
"""Standard deviation of the logarithms of hyper-parameters that are relearned, around those given."""

_STREAMS = ("initial", "candidates", "relearning")


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

    With `relearn_every`, the hyper-parameters of the kernel and the noise are relearned from the standardised
    values: those of greatest posterior density, if those given are the medians of a log-normal prior. In a
    batch whose states are given apart (not those of `maximise`), every lane pays for that at every step.

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
        relearn_every: Evaluations from one relearning to the next; 0 for none.
    """

    kernel: Kernel
    acquisition: Acquisition
    noise_variance: Float[Array, ""] = eqx.field(converter=as_numbers("noise_variance"))
    low: Float[Array, "D"] = eqx.field(converter=as_numbers("low"))
    high: Float[Array, "D"] = eqx.field(converter=as_numbers("high"))
    capacity: int = eqx.field(static=True)
    num_candidates: int = eqx.field(static=True, default=512)
    num_initial: int = eqx.field(static=True, default=4)
    refine_steps: int = eqx.field(static=True, default=20)
    relearn_every: int = eqx.field(static=True, default=0)

    def __check_init__(self):
        """Parts are of their classes and of one precision, sizes are integers, and the box is one.

        Raises:
            ValueError: One of them is not; one line says what is allowed.
        """
        check_kind("kernel", self.kernel, Kernel, "Matern52(0.5)")
        check_kind("acquisition", self.acquisition, Acquisition, "LogExpectedImprovement(0.0)")
        least = {"capacity": 1, "num_candidates": 1, "num_initial": 1, "refine_steps": 0, "relearn_every": 0}
        for name, number in least.items():
            check_count(name, getattr(self, name), number)
        if self.noise_variance.shape:
            raise ValueError(f"noise_variance: got shape {self.noise_variance.shape}; allowed: one number")
        for name, corner in (("low", self.low), ("high", self.high)):
            if corner.ndim != 1 or not corner.size or corner.shape != self.low.shape:
                raise ValueError(
                    f"{name}: got shape {corner.shape}; allowed: one number a dimension, as many in both"
                )
        for path, leaf in jax.tree_util.tree_leaves_with_path(self):
            if leaf.dtype != self.low.dtype:
                name = jax.tree_util.keystr(path).removeprefix(".")
                raise ValueError(f"{name}: got {leaf.dtype}; allowed: {self.low.dtype}, that of `low`")
        check_takes("kernel", self.kernel, 2, self.low.size, self.low.dtype, "those of the box")
        if is_known(self):
            self._check_numbers()

    def _check_numbers(self) -> None:
        check_positive("kernel", self.kernel)
        check_finite("acquisition", self.acquisition)
        check_number(
            "noise_variance", self.noise_variance, 0.0, str(self.low.dtype), is_above=self.relearn_every > 0
        )
        low, high = np.asarray(self.low), np.asarray(self.high)
        with np.errstate(over="ignore"):
            width = high - low
        for i in range(len(low)):
            if not (np.isfinite(width[i]) and width[i] >= np.finfo(low.dtype).tiny):
                raise ValueError(
                    f"high[{i}]: got {high[i]:g}; allowed: > low[{i}], which is {low[i]:g}, and finite"
                )

    def init(self, key: Key[Array, ""]) -> OptimisationState:
        """No observation yet."""
        check_key("key", key)
        return OptimisationState(
            key=key,
            model=GaussianProcess.prior(self.kernel, self.noise_variance, self.capacity, self.low.shape[0]),
            num_told=jnp.zeros((), jnp.int32),
            num_missing=jnp.zeros((), jnp.int32),
            was_missing=jnp.zeros((), bool),
        )

    def ask(self, state: OptimisationState) -> Float[Array, "D"]:
        """Where to evaluate next; the same state gives the same point."""
        model = _standardised(state.model)
        # Without observations every point is as good: any finite threshold does.
        best = jnp.where(model.count > 0, jnp.max(jnp.where(model.is_held(), model.y, -jnp.inf)), 0.0)
        candidates = self._quasirandom(jax.random.fold_in(_stream(state, "candidates"), state.num_told))
        choice = best_candidate(self.acquisition, model, best, candidates, model.whiten(candidates))
        point = candidates[choice]
        if self.refine_steps > 0:
            point = refine(self.acquisition, model, best, point, self.refine_steps)
        initial = self._quasirandom(_stream(state, "initial"))[state.num_told % self.num_candidates]
        is_initial = (model.count < self.num_initial) | state.was_missing
        return self._from_unit(jnp.where(is_initial, initial, point))

    def tell(
        self,
        state: OptimisationState,
        x: Float[Array, "D"] | Float[np.ndarray, "D"] | Sequence[int | float],
        y: Float[Array, ""] | Float[np.ndarray, ""] | int | float,
    ) -> OptimisationState:
        """The state after `y` was observed at `x`, which may be another point than the one asked for.

        Raises:
            ValueError: `x` is no point, or `y` no number.
        """
        point = as_numbers("x")(x).astype(self.low.dtype)
        observed = as_numbers("y")(y).astype(self.low.dtype)
        if point.shape != self.low.shape or observed.shape:
            raise ValueError(
                f"x, y: got shapes {point.shape} and {observed.shape}; "
                f"allowed: {self.low.shape} and one number"
            )
        is_missing = ~(jnp.isfinite(observed) & jnp.all(jnp.isfinite(point)))
        model = state.model.extend(self._to_unit(point)[None, :], observed[None], ~is_missing[None])
        num_told = state.num_told + 1
        if self.relearn_every > 0:
            key = jax.random.fold_in(_stream(state, "relearning"), num_told)
            # The number told is the same in all lanes of a batch: `cond` stays one.
            is_due = num_told % self.relearn_every == 0
            model = jax.lax.cond(is_due, lambda: self._relearn(key, model), lambda: model)
        return OptimisationState(
            key=state.key,
            model=model,
            num_told=num_told,
            num_missing=state.num_missing + is_missing.astype(jnp.int32),
            was_missing=is_missing,
        )

    def best(self, state: OptimisationState) -> tuple[Float[Array, "D"], Float[Array, ""]]:
        """The point of the highest value observed, and that value; before any, the centre and -infinity."""
        values = jnp.where(state.model.is_held(), state.model.y, -jnp.inf)
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
        check_key("key", key)
        check_count("num_iterations", num_iterations, 1)
        if num_iterations > self.capacity:
            raise ValueError(f"num_iterations: {num_iterations}; the capacity is {self.capacity}")
        key_search, key_noise = jax.random.split(key)

        def step(state: OptimisationState, index: Int[Array, ""]):
            x = self.ask(state)
            y = function(jax.random.fold_in(key_noise, index), x)
            return self.tell(state, x, y), (x, y)

        state, (xs, ys) = jax.lax.scan(step, self.init(key_search), jnp.arange(num_iterations))
        return state, xs, ys

    def _relearn(self, key: Key[Array, ""], model: GaussianProcess) -> GaussianProcess:
        log_prior = log_normal_prior(self.kernel, self.noise_variance, PRIOR_SPREAD)
        learned, _ = relearn(_standardised(model), key, log_prior=log_prior, num_starts=4)
        return eqx.tree_at(lambda gp: gp.y, learned, model.y)

    def _quasirandom(self, key: Key[Array, ""]) -> Float[Array, "C D"]:
        return shifted_kronecker(key, self.num_candidates, self.low.shape[0], self.low.dtype)

    def _from_unit(self, point: Float[Array, "D"]) -> Float[Array, "D"]:
        # A weighted sum of the corners stays between them, as their difference times a number might not.
        weight = 0.5 * (point + 1.0)
        return (1.0 - weight) * self.low + weight * self.high

    def _to_unit(self, x: Float[Array, "D"]) -> Float[Array, "D"]:
        return 2.0 * (x - self.low) / (self.high - self.low) - 1.0


def _standardised(model: GaussianProcess) -> GaussianProcess:
    return eqx.tree_at(lambda gp: gp.y, model, standardise(model.y, model.is_held()))


def _stream(state: OptimisationState, name: str) -> Key[Array, ""]:
    return jax.random.fold_in(state.key, _STREAMS.index(name))
