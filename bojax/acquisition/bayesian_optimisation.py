"""Bayesian optimisation (Algorithm 1), as an ask-and-tell interface or as one compiled loop."""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Key, Scalar

from bojax.acquisition.functions import Acquisition, UpperConfidenceBound
from bojax.acquisition.maximise import best_candidate, best_refined, refine
from bojax.acquisition.thompson import ThompsonSampling
from bojax.models.checks import (
    Numbers,
    as_numbers,
    by_name,
    check_count,
    check_finite,
    check_key,
    check_kind,
    check_number,
    check_positive,
    check_takes,
    compiled_if_known,
    is_known,
    to_numbers,
    to_points,
)
from bojax.models.evidence import log_normal_prior, relearn
from bojax.models.gaussian_process import GaussianProcess
from bojax.models.kernels import Kernel
from bojax.models.means import ConstantMean, Mean, ZeroMean
from bojax.numerics.quasirandom import shifted_kronecker

PRIOR_SPREAD = 1.5  # default of `prior_spread`

NOISE_SPREAD_BELOW = 20.0
"""Standard deviation of the noise's prior below its median, in units of `prior_spread`: an objective without
noise is found to have none, while few noisy values are not explained as noise alone."""

LOCAL_DECADES = (-3.0, 0.5)
"""Decimal logarithms of the least and the greatest distance of candidates near the best observed point, in
units of half the box."""

_STREAMS = ("initial", "candidates", "relearning", "draws", "local")


class OptimisationState(eqx.Module):
    """State of an optimisation.

    Attributes:
        key: Random key, from which every step derives its own by its number.
        model: Observations, with inputs mapped to [-1, 1]^D and values in the units of the objective; kernel,
            noise variance and mean refer to standardised values.
        num_told: Number of evaluations, including missing ones.
        num_missing: Number of missing evaluations, whose point or value was not finite.
        was_missing: Whether the last evaluation is missing.
    """

    key: Key[Array, ""]
    model: GaussianProcess
    num_told: Int[Array, ""]
    num_missing: Int[Array, ""]
    was_missing: Bool[Array, ""]


class BayesianOptimisation(eqx.Module):
    """Maximisation of a function over a box (Algorithm 1); to minimise a function, maximise its negative.

    The Gaussian process models standardised values at points mapped to [-1, 1]^D. The kernel, the noise
    variance and the acquisition function are given in these units. Every step draws new quasi-random
    candidates, and refines the one of highest acquisition by gradient steps; the thesis names DIRECT.

    With `relearn_every`, the hyper-parameters of the kernel and the noise variance are relearned from the
    standardised values by maximum a posteriori estimation, with a log-normal prior whose medians are the
    given values; the prior of the noise variance is wider below its median (`NOISE_SPREAD_BELOW`). A constant
    mean of the standardised values is learned with them. If `tell` is vmapped over states, every lane
    computes this at every step; `maximise` does not.

    An evaluation whose value or point is not finite is missing and does not enter the model.

    `ask` and `tell` are compiled by themselves, once for all optimisations of the same sizes, and take Python
    numbers, lists and arrays.

    Attributes:
        kernel: Covariance of the values, an object or a name, such as `"matern52"`.
        acquisition: Acquisition function, an object or a name, such as `"log-ei"`; or `ThompsonSampling()`,
            which maximises a new draw of the posterior at every step.
        noise_variance: Noise variance of an observation, relative to the variance of the observed values.
        low: Lower corner of the box.
        high: Upper corner of the box.
        capacity: Maximum number of observations. `tell` refuses further ones; in a compiled function, they
            are counted by `num_ignored` of the state's model.
        num_candidates: Number of candidates over which the acquisition is maximised.
        num_initial: Number of initial observations, at quasi-random points.
        refine_steps: Number of gradient steps from the best candidate; 0 disables them.
        num_local: Number of further candidates near the best observed point, at distances of all scales.
        num_starts: Number of the best candidates from which gradient steps are taken.
        relearn_every: Number of evaluations between two relearnings; 0 disables relearning.
        prior_spread: Standard deviation of the log-normal prior of relearned hyper-parameters, in the
            logarithm.
    """

    kernel: Kernel = eqx.field(converter=by_name("kernel"))
    acquisition: Acquisition | ThompsonSampling = eqx.field(converter=by_name("acquisition"))
    noise_variance: Float[Array, ""] = eqx.field(converter=as_numbers("noise_variance"))
    low: Float[Array, "D"] = eqx.field(converter=as_numbers("low"))
    high: Float[Array, "D"] = eqx.field(converter=as_numbers("high"))
    capacity: int = eqx.field(static=True)
    num_candidates: int = eqx.field(static=True, default=512)
    num_initial: int = eqx.field(static=True, default=4)
    refine_steps: int = eqx.field(static=True, default=20)
    num_local: int = eqx.field(static=True, default=0)
    num_starts: int = eqx.field(static=True, default=1)
    relearn_every: int = eqx.field(static=True, default=0)
    prior_spread: float = eqx.field(static=True, default=PRIOR_SPREAD)

    def __check_init__(self):
        """Check the parts, their common precision, the sizes and the box, or raise ValueError."""
        check_kind("kernel", self.kernel, Kernel, "Matern52(0.5)")
        if not isinstance(self.acquisition, ThompsonSampling):
            check_kind("acquisition", self.acquisition, Acquisition, "LogExpectedImprovement(0.0)")
        least = {"capacity": 1, "num_candidates": 1, "num_initial": 1, "refine_steps": 0, "relearn_every": 0}
        least |= {"num_local": 0, "num_starts": 1}
        for name, number in least.items():
            check_count(name, getattr(self, name), number)
        check_number("prior_spread", self.prior_spread, str(self.low.dtype), is_above=True)
        if self.noise_variance.shape:
            raise ValueError(f"noise_variance: got shape {self.noise_variance.shape}; allowed: one number")
        for name, corner in (("low", self.low), ("high", self.high)):
            if corner.ndim != 1 or not corner.size or corner.shape != self.low.shape:
                raise ValueError(
                    f"{name}: got shape {corner.shape}; allowed: one number per dimension, as many in both"
                )
        for path, leaf in jax.tree_util.tree_leaves_with_path(self):
            if leaf.dtype != self.low.dtype:
                name = jax.tree_util.keystr(path).removeprefix(".")
                raise ValueError(f"{name}: got {leaf.dtype}; allowed: {self.low.dtype}, as `low`")
        check_takes("kernel", self.kernel, 2, self.low.size, self.low.dtype, "those of the box")
        if is_known(self):
            self._check_numbers()

    def _check_numbers(self) -> None:
        check_positive("kernel", self.kernel)
        check_finite("acquisition", self.acquisition)
        check_number(
            "noise_variance", self.noise_variance, str(self.low.dtype), is_above=self.relearn_every > 0
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
        """The state before any evaluation."""
        check_key(key)
        return OptimisationState(
            key=key,
            model=GaussianProcess.prior(
                self.kernel, self.noise_variance, self.capacity, self.low.shape[0], self._mean()
            ),
            num_told=jnp.zeros((), jnp.int32),
            num_missing=jnp.zeros((), jnp.int32),
            was_missing=jnp.zeros((), bool),
        )

    @compiled_if_known
    def ask(self, state: OptimisationState) -> Float[Array, "D"]:
        """The next point to evaluate, a function of the state alone."""
        acquisition, model = self._target(state)
        best = highest(model)
        candidates = self._quasirandom(jax.random.fold_in(_stream(state, "candidates"), state.num_told))
        if self.num_local > 0:
            candidates = jnp.concatenate([candidates, self._near_best(state)])
        if self.num_starts == 1:
            choice = best_candidate(acquisition, model, best, candidates, model.whiten(candidates))
            point = candidates[choice]
            if self.refine_steps > 0:
                point = refine(acquisition, model, best, point, self.refine_steps)
        else:
            point = best_refined(acquisition, model, best, candidates, self.num_starts, self.refine_steps)
        # After a missing evaluation, the model would ask for nearly the same point again: a quasi-random one
        # instead.
        initial = self._quasirandom(_stream(state, "initial"))[state.num_told % self.num_candidates]
        is_initial = (model.count < self.num_initial) | state.was_missing
        return self._from_unit(jnp.where(is_initial, initial, point))

    def tell(
        self, state: OptimisationState, x: Float[Array, "D"] | Numbers, y: Float[Array, ""] | Numbers
    ) -> OptimisationState:
        """The state after observing `y` at `x`, which need not be the point from `ask`.

        Raises:
            ValueError: `x` is not a point, `y` is not a number, or the capacity is reached (unless compiled).
        """
        point = to_numbers("x", x, self.low.dtype)
        observed = to_numbers("y", y, self.low.dtype)
        if point.shape != self.low.shape or observed.shape:
            raise ValueError(
                f"x, y: got shapes {point.shape} and {observed.shape}; "
                f"allowed: {self.low.shape} and one number"
            )
        after = self._told(state, point, observed)
        ignored = after.model.num_ignored, state.model.num_ignored
        if is_known(ignored) and ignored[0] > ignored[1]:
            raise ValueError(
                f"tell: got one observation more than {self.capacity}; allowed: <= capacity: set a larger one"
            )
        return after

    @compiled_if_known
    def _told(
        self, state: OptimisationState, point: Float[Array, "D"], observed: Float[Array, ""]
    ) -> OptimisationState:
        is_missing = ~(jnp.isfinite(observed) & jnp.all(jnp.isfinite(point)))
        model = state.model.extend(self._to_unit(point)[None, :], observed[None], ~is_missing[None])
        num_told = state.num_told + 1
        if self.relearn_every > 0:
            key = jax.random.fold_in(_stream(state, "relearning"), num_told)
            # In `maximise`, `num_told` is the same in all lanes of a batch, so that this stays a `cond`.
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
        """The point of the highest observed value, and the value; the centre and -infinity without any."""
        values = jnp.where(state.model.is_held(), state.model.y, -jnp.inf)
        return self._from_unit(state.model.x[jnp.argmax(values)]), jnp.max(values)

    def observations(self, state: OptimisationState) -> tuple[Float[Array, "N D"], Float[Array, "N"]]:
        """Points of the box and values that the model holds; rows past the count are meaningless."""
        return jax.vmap(self._from_unit)(state.model.x), state.model.y

    def predict(
        self, state: OptimisationState, xs: Float[Array, "M D"] | Numbers
    ) -> tuple[Float[Array, "M"], Float[Array, "M"]]:
        """Posterior mean and standard deviation of the noise-free objective at points of the box.

        Both are in the units of the objective. The unit of the kernel is the standard deviation of the
        observed values, or 1 if they are all equal.
        """
        centre, unit = self._scale(state)
        mean, variance = _standardised(state.model).predict(self._units(xs))
        return centre + unit * mean, unit * jnp.sqrt(variance)

    def sample(
        self, key: Key[Array, ""], state: OptimisationState, xs: Float[Array, "M D"] | Numbers, num: int
    ) -> Float[Array, "num M"]:
        """Joint draws of the noise-free objective at points of the box, in its units."""
        centre, unit = self._scale(state)
        draws = _standardised(state.model).sample(key, self._units(xs), num)
        return centre + unit * draws

    def score(self, state: OptimisationState, xs: Float[Array, "M D"] | Numbers) -> Float[Array, "M"]:
        """The acquisition function, or the draw, at points of the box, whose maximum `ask` seeks."""
        return _score(self, state, to_points("xs", xs, self.low.dtype, self.low.size))

    def _scored(self, state: OptimisationState, xs: Float[Array, "M D"]) -> Float[Array, "M"]:
        acquisition, model = self._target(state)
        mean, variance = model.predict(self._units(xs))
        return acquisition(mean, jnp.sqrt(variance), highest(model))

    def noise_std(self, state: OptimisationState) -> Float[Array, ""]:
        """Standard deviation of the noise of an observation, in the units of the objective."""
        return self._scale(state)[1] * jnp.sqrt(state.model.noise_variance)

    @compiled_if_known
    def maximise(
        self,
        key: Key[Array, ""],
        function: Callable[[Key[Array, ""], Float[Array, "D"]], Scalar],
        num_iterations: int,
    ) -> tuple[OptimisationState, Float[Array, "T D"], Float[Array, "T"]]:
        """Ask, evaluate and tell `num_iterations` times in one compiled loop.

        Args:
            key: Random key of the optimisation and of the function.
            function: Takes a key for its noise and a point of the box, and returns an observation.
            num_iterations: Number of evaluations T, a Python integer.

        Returns:
            The final state, and all points and values in order, including missing values.

        Raises:
            ValueError: `num_iterations` exceeds the capacity.
        """
        check_key(key)
        check_count("num_iterations", num_iterations, 1)
        if num_iterations > self.capacity:
            raise ValueError(
                f"num_iterations: got {num_iterations}; allowed: <= {self.capacity}, the capacity"
            )
        key_search, key_noise = jax.random.split(key)

        def step(state: OptimisationState, index: Int[Array, ""]):
            x = self.ask(state)
            y = function(jax.random.fold_in(key_noise, index), x)
            return self.tell(state, x, y), (x, y)

        state, (xs, ys) = jax.lax.scan(step, self.init(key_search), jnp.arange(num_iterations))
        return state, xs, ys

    def _mean(self) -> Mean:
        """The prior mean of standardised values before it is learned."""
        return ConstantMean(jnp.zeros((), self.low.dtype)) if self.relearn_every > 0 else ZeroMean()

    def _target(self, state: OptimisationState) -> tuple[Acquisition, GaussianProcess]:
        """What `ask` maximises: a function of the moments of a process."""
        model = _standardised(state.model)
        if not isinstance(self.acquisition, ThompsonSampling):
            return self.acquisition, model
        # The draw is the posterior mean of a process, and an upper bound with kappa 0 is this mean.
        key = jax.random.fold_in(_stream(state, "draws"), state.num_told)
        return UpperConfidenceBound(jnp.zeros((), self.low.dtype)), self.acquisition.draw(key, model)

    def _relearn(self, key: Key[Array, ""], model: GaussianProcess) -> GaussianProcess:
        # The model holds values in the units of the objective, which are standardised anew for every use.
        below = NOISE_SPREAD_BELOW * self.prior_spread
        log_prior = log_normal_prior(self.kernel, self.noise_variance, self.prior_spread, below)
        learned, _ = relearn(_standardised(model), key, log_prior=log_prior, num_starts=4, learn_mean=True)
        return eqx.tree_at(lambda gp: gp.y, learned, model.y)

    def _scale(self, state: OptimisationState) -> tuple[Float[Array, ""], Float[Array, ""]]:
        """Value and unit of the objective that are 0 and 1 of the standardised values."""
        return standardise(state.model.y, state.model.is_held())[1:]

    def _quasirandom(self, key: Key[Array, ""]) -> Float[Array, "C D"]:
        return shifted_kronecker(key, self.num_candidates, self.low.shape[0], self.low.dtype)

    def _near_best(self, state: OptimisationState) -> Float[Array, "L D"]:
        """Points in some coordinates as the best observed one, and in the others near it."""
        values = jnp.where(state.model.is_held(), state.model.y, -jnp.inf)
        best, num_dims, dtype = state.model.x[None, jnp.argmax(values)], self.low.shape[0], self.low.dtype
        shape = (self.num_local, num_dims)
        key = jax.random.fold_in(_stream(state, "local"), state.num_told)
        key_size, key_change, key_which = jax.random.split(key, 3)
        size = 10.0 ** jax.random.uniform(key_size, (self.num_local, 1), dtype, *LOCAL_DECADES)
        change = size * jax.random.normal(key_change, shape, dtype)
        is_changed = jax.random.uniform(key_which, shape, dtype) < max(0.5, 1.0 / num_dims)
        return jnp.clip(jnp.where(is_changed, best + change, best), -1.0, 1.0)

    def _from_unit(self, point: Float[Array, "D"]) -> Float[Array, "D"]:
        # Unlike low + weight * (high - low), a weighted sum of the corners cannot leave the box by rounding.
        weight = 0.5 * (point + 1.0)
        return (1.0 - weight) * self.low + weight * self.high

    def _units(self, xs: Float[Array, "M D"] | Numbers) -> Float[Array, "M D"]:
        return jax.vmap(self._to_unit)(to_points("xs", xs, self.low.dtype, self.low.size))

    def _to_unit(self, x: Float[Array, "D"]) -> Float[Array, "D"]:
        return 2.0 * (x - self.low) / (self.high - self.low) - 1.0


def _standardised(model: GaussianProcess) -> GaussianProcess:
    return eqx.tree_at(lambda gp: gp.y, model, standardise(model.y, model.is_held())[0])


def standardise(
    values: Float[Array, "N"], exists: Bool[Array, "N"]
) -> tuple[Float[Array, "N"], Float[Array, ""], Float[Array, ""]]:
    """Values of mean 0 and variance 1, the mean that was subtracted, and the deviation that divides.

    Values are 0 if all are equal, and where `exists` is false. Equal values are divided by 1, and the mean of
    none is 0.
    """
    values = jnp.where(exists, values, 0.0)
    # Without this scaling, squares of large values would overflow.
    largest = jnp.max(jnp.abs(values), initial=0.0)
    largest = jnp.where(largest > 0.0, largest, 1.0)
    values = values / largest
    number = jnp.maximum(jnp.sum(exists), 1).astype(values.dtype)
    mean = jnp.sum(values) / number
    centred = jnp.where(exists, values - mean, 0.0)
    std = jnp.sqrt(jnp.sum(centred**2) / number)
    # Equal values differ from their mean by rounding only.
    is_constant = std <= 100.0 * jnp.finfo(values.dtype).eps
    scaled = jnp.where(is_constant, 0.0, centred / jnp.where(is_constant, 1.0, std))
    return scaled, largest * mean, jnp.where(is_constant, 1.0, largest * std)


def highest(model: GaussianProcess) -> Float[Array, ""]:
    """The highest observed value, the `best` of an acquisition function.

    It is 0 without observations: the posterior is then the same at all points, so that any finite number
    ranks them equally.
    """
    return jnp.where(model.count > 0, jnp.max(jnp.where(model.is_held(), model.y, -jnp.inf)), 0.0)


def _stream(state: OptimisationState, name: str) -> Key[Array, ""]:
    return jax.random.fold_in(state.key, _STREAMS.index(name))


_score = eqx.filter_jit(BayesianOptimisation._scored)
