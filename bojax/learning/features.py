"""Features phi(s, a) of states and actions, bilinear in features x(s) of the state and y(a) of the action.

Because phi(s, a) = join(x(s), y(a)) is bilinear, a linear function of phi is linear in x(s) for a fixed
action, w'phi(s, a) = x(s)'split(w, y(a)), and the mean over actions of a quadratic form in phi is a quadratic
form in x(s). `FeatureSpec.draw` makes a feature map for the spaces of an environment.
"""

import abc
from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Key
from typing_extensions import override

from bojax.config.limits import FEATURES
from bojax.envs.base import Action, Observation
from bojax.envs.spaces import Discrete, Space
from bojax.models.features import FourierBasis, RandomFourier, Sampling
from bojax.models.kernels import RBF, Matern12, Matern32, Matern52
from bojax.numerics.angles import cos_and_sin
from bojax.numerics.linalg import HIGHEST, matmul
from bojax.numerics.quasirandom import scrambled_halton


class StateActionFeatures(eqx.Module):
    """A feature map phi from a state and an action to M features; P and R are the sizes of x and y."""

    actions: eqx.AbstractVar[Space]  # space of actions

    @property
    @abc.abstractmethod
    def num_features(self) -> int:
        """M."""

    @abc.abstractmethod
    def state(self, observation: Observation) -> Float[Array, "P"]:
        """x(s)."""

    @abc.abstractmethod
    def action(self, action: Action) -> Float[Array, "R"]:
        """y(a)."""

    @abc.abstractmethod
    def join(self, x: Float[Array, "P"], y: Float[Array, "R"]) -> Float[Array, "M"]:
        """phi(s, a)."""

    @abc.abstractmethod
    def split(self, weights: Float[Array, "M"], y: Float[Array, "R"]) -> Float[Array, "P"]:
        """The adjoint of `join` in x: weights'join(x, y) = x'split(weights, y)."""

    def __call__(self, observation: Observation, action: Action) -> Float[Array, "M"]:
        """phi(s, a)."""
        return self.join(self.state(observation), self.action(action))

    @abc.abstractmethod
    def values(
        self, weights: Float[Array, "M"], observation: Observation, actions: Action
    ) -> Float[Array, "J"]:
        """weights'phi(s, a) of several actions."""

    @abc.abstractmethod
    def mean_form(self, matrix: Float[Array, "M M"], ys: Float[Array, "K R"]) -> Float[Array, "P P"]:
        """The matrix F with x'F x equal to the mean of phi'matrix phi over the actions with features `ys`.

        Only the second moments of `ys` enter, so that the cost hardly depends on the number of actions.
        """


class FourierFeatures(StateActionFeatures):
    """Cosines of linear functions of the state and action, mapped to the unit cube."""

    observations: Space  # bounds of observations
    actions: Space  # space of actions
    state_frequencies: Float[Array, "M D"]  # angular frequencies along each observation, in radians per range
    action_frequencies: Float[Array, "M A"]  # angular frequencies along each action dimension
    phases: Float[Array, "M"]  # phase of each feature, in radians
    amplitude: Float[Array, ""]  # amplitude of every feature
    # Whether the second half are the sines of the first half: cosines of phases less pi/2
    has_sines: bool = eqx.field(static=True)

    @property
    @override
    def num_features(self) -> int:
        return len(self.phases)

    @override
    def state(self, observation: Observation) -> Float[Array, "P"]:
        """Cosines and sines of the state's part of the angles."""
        number = self._num_angles
        unit = self.observations.to_unit(observation).astype(self.phases.dtype)
        angles = matmul(self.state_frequencies[:number], unit) + self.phases[:number]
        return self.amplitude * jnp.concatenate(cos_and_sin(angles))

    @override
    def action(self, action: Action) -> Float[Array, "R"]:
        """Cosines and sines of the action's part of the angles."""
        unit = self.actions.to_unit(action).astype(self.phases.dtype)
        angles = matmul(self.action_frequencies[: self._num_angles], unit)
        return jnp.concatenate(cos_and_sin(angles))

    @override
    def join(self, x: Float[Array, "P"], y: Float[Array, "R"]) -> Float[Array, "M"]:
        """Cosines, and sines if there are any, of the sums of both parts of the angles."""
        # cos(s + a) = cos s cos a - sin s sin a, and likewise for the sine: bilinear in the parts of state
        # and action.
        (cx, sx), (cy, sy) = jnp.split(x, 2), jnp.split(y, 2)
        cosines = cx * cy - sx * sy
        return jnp.concatenate([cosines, sx * cy + cx * sy]) if self.has_sines else cosines

    @override
    def __call__(self, observation: Observation, action: Action) -> Float[Array, "M"]:
        # On a GPU, XLA fuses the cosines with the products that they enter, which a concatenation prevents.
        # On a CPU, the cosine and the sine of an angle have most of their arithmetic in common.
        has_pairs = self.has_sines and jax.default_backend() == "cpu"
        number, dtype = self._num_angles if has_pairs else len(self.phases), self.phases.dtype
        state = self.observations.to_unit(observation).astype(dtype)
        angles = matmul(self.state_frequencies[:number], state) + self.phases[:number]
        action = self.actions.to_unit(action).astype(dtype)
        angles = angles + matmul(self.action_frequencies[:number], action)
        cosines, sines = cos_and_sin(angles)
        return self.amplitude * (jnp.concatenate([cosines, sines]) if has_pairs else cosines)

    @override
    def values(
        self, weights: Float[Array, "M"], observation: Observation, actions: Action
    ) -> Float[Array, "J"]:
        dtype, number = self.phases.dtype, self._num_angles
        unit, units = self.observations.to_unit(observation), self.actions.to_unit(actions)
        angles = matmul(self.state_frequencies[:number], unit.astype(dtype)) + self.phases[:number]
        if self.has_sines:
            # c cos t + s sin t = r cos(t - d), with r and d the polar coordinates of (c, s): one cosine for
            # each pair of a frequency and an action.
            c, s = jnp.split(weights, 2)
            weights, angles = jnp.hypot(c, s), angles - jnp.arctan2(s, c)
        angles = angles[None, :] + matmul(units.astype(dtype), self.action_frequencies[:number].T)
        return self.amplitude * matmul(cos_and_sin(angles)[0], weights)

    @override
    def split(self, weights: Float[Array, "M"], y: Float[Array, "R"]) -> Float[Array, "P"]:
        cy, sy = jnp.split(y, 2)
        if not self.has_sines:
            return jnp.concatenate([weights * cy, -weights * sy])
        wc, ws = jnp.split(weights, 2)
        return jnp.concatenate([wc * cy + ws * sy, ws * cy - wc * sy])

    @override
    def mean_form(self, matrix: Float[Array, "M M"], ys: Float[Array, "K R"]) -> Float[Array, "P P"]:
        # With C and D the diagonal matrices of cos and sin of the action's angles, the cosines of phi are
        # C cx - D sx and its sines D cx + C sx. C A D has the entries A_ij cos_i sin_j.
        (cc, cd), (dc, dd) = _quarters(matmul(ys.T, ys) / len(ys))
        if not self.has_sines:
            return jnp.block([[cc * matrix, -cd * matrix], [-dc * matrix, dd * matrix]])
        (a, b), (c, d) = _quarters(matrix)
        return jnp.block(
            [
                [cc * a + cd * b + dc * c + dd * d, cc * b - cd * a + dc * d - dd * c],
                [cc * c + cd * d - dc * a - dd * b, cc * d - cd * c - dc * b + dd * a],
            ]
        )

    @property
    def _num_angles(self) -> int:
        return len(self.phases) // (1 + self.has_sines)


class FourierBasisMap(StateActionFeatures):
    """The Fourier basis (5.23) of a state and an action: a cosine for each pair of frequencies of the two.

    The pairs are in the order of the action's frequencies, and for each of these in that of the state's. With
    the cosines and sines of a state as the two rows of X, and the cosines and negative sines of an action as
    those of Y, phi is Y'X, since cos(s + a) = cos s cos a - sin s sin a.
    """

    observations: Space  # bounds of observations, which are mapped to [0, 1]
    actions: Space  # bounds of actions, likewise
    state_frequencies: Float[Array, "I D"]  # angular frequencies along each observation, in radians per range
    action_frequencies: Float[Array, "H A"]  # angular frequencies along each action dimension

    @property
    @override
    def num_features(self) -> int:
        return len(self.state_frequencies) * len(self.action_frequencies)

    @override
    def state(self, observation: Observation) -> Float[Array, "P"]:
        """Cosines and sines of the state's part of the angles."""
        unit = self.observations.to_unit(observation).astype(self.state_frequencies.dtype)
        return jnp.concatenate(cos_and_sin(matmul(self.state_frequencies, unit)))

    @override
    def action(self, action: Action) -> Float[Array, "R"]:
        """Cosines and negative sines of the action's part of the angles."""
        unit = self.actions.to_unit(action).astype(self.action_frequencies.dtype)
        return jnp.concatenate(cos_and_sin(-matmul(self.action_frequencies, unit)))

    @override
    def join(self, x: Float[Array, "P"], y: Float[Array, "R"]) -> Float[Array, "M"]:
        return matmul(y.reshape(2, -1).T, x.reshape(2, -1)).ravel()

    @override
    def values(
        self, weights: Float[Array, "M"], observation: Observation, actions: Action
    ) -> Float[Array, "J"]:
        # The weights are multiplied by the cosines and sines of the state once for all actions: two numbers
        # for each frequency of the action are left. For 15 actions of a double pendulum with order 3, this
        # saves 240,000 cosines.
        x = self.state(observation).reshape(2, -1)
        sums = matmul(x, weights.reshape(-1, x.shape[1]).T)
        return matmul(jax.vmap(self.action)(actions), sums.ravel())

    @override
    def split(self, weights: Float[Array, "M"], y: Float[Array, "R"]) -> Float[Array, "P"]:
        y = y.reshape(2, -1)
        return matmul(y, weights.reshape(y.shape[1], -1)).ravel()

    @override
    def mean_form(self, matrix: Float[Array, "M M"], ys: Float[Array, "K R"]) -> Float[Array, "P P"]:
        by_pair = matrix.reshape(2 * (len(self.action_frequencies), len(self.state_frequencies)))

        def form(moments):
            return jnp.einsum("rpsq,rs->pq", by_pair, moments, precision=HIGHEST)

        quarters = _quarters(matmul(ys.T, ys) / len(ys))
        return jnp.block([[form(moments) for moments in row] for row in quarters])


class ProductFeatures(StateActionFeatures):
    """Features whose phi is the outer product of x and y."""

    @override
    def join(self, x: Float[Array, "P"], y: Float[Array, "R"]) -> Float[Array, "M"]:
        return (x[:, None] * y[None, :]).ravel()

    @override
    def values(
        self, weights: Float[Array, "M"], observation: Observation, actions: Action
    ) -> Float[Array, "J"]:
        x, ys = self.state(observation), jax.vmap(self.action)(actions)
        return matmul(ys, matmul(x, weights.reshape(len(x), -1)))

    @override
    def split(self, weights: Float[Array, "M"], y: Float[Array, "R"]) -> Float[Array, "P"]:
        return matmul(weights.reshape(-1, len(y)), y)

    @override
    def mean_form(self, matrix: Float[Array, "M M"], ys: Float[Array, "K R"]) -> Float[Array, "P P"]:
        by_pair = matrix.reshape(2 * (len(matrix) // ys.shape[1], ys.shape[1]))
        return jnp.einsum("prqs,rs->pq", by_pair, matmul(ys.T, ys) / len(ys), precision=HIGHEST)


class OneHotFeatures(ProductFeatures):
    """One-hot features of a discrete state and a discrete action: one feature for each pair."""

    observations: Discrete  # space of states
    actions: Space  # space of actions
    one: Float[Array, ""]  # the number 1 in the precision of the features

    @property
    @override
    def num_features(self) -> int:
        return self.observations.num * self._num_actions

    @override
    def state(self, observation: Observation) -> Float[Array, "P"]:
        return jax.nn.one_hot(observation, self.observations.num, dtype=self.one.dtype)

    @override
    def action(self, action: Action) -> Float[Array, "R"]:
        return jax.nn.one_hot(action, self._num_actions, dtype=self.one.dtype)

    @property
    def _num_actions(self) -> int:
        assert isinstance(self.actions, Discrete)
        return self.actions.num


class FeatureSpec(eqx.Module):
    """Settings of a feature map; the map itself is drawn once for each run."""

    def check_spaces(self, observation_space: Space, action_space: Space) -> None:
        """Refuse spaces for which the features cannot be drawn; by default all are accepted.

        Raises:
            ValueError: The spaces do not fit.
        """

    def fitted(self, observation_space: Space, action_space: Space, dtype: jnp.dtype) -> "FeatureSpec":
        """Settings for these spaces, with numbers of `dtype`; by default they are these settings."""
        return self

    def count(self, observation_space: Space, action_space: Space) -> int:
        """The number of features that `draw` draws for these spaces."""
        key, dtype = jax.random.key(0), jnp.dtype(jnp.float32)
        drawn = jax.eval_shape(lambda key: self.draw(key, observation_space, action_space, dtype), key)
        return drawn.num_features

    @abc.abstractmethod
    def draw(
        self, key: Key[Array, ""], observation_space: Space, action_space: Space, dtype: jnp.dtype
    ) -> StateActionFeatures:
        """Draw a feature map for the given spaces.

        Raises:
            ValueError: The features do not apply to these spaces.
        """


class RandomFourierSpec(FeatureSpec):
    """Random Fourier features of a stationary kernel (2.33), with bounds mapped to [0, 1].

    Settings: `bojax.learning.settings.RandomFourierFeatures`.
    """

    state_lengthscale: Float[Array, ""]
    action_lengthscale: Float[Array, ""]
    num_features: int = eqx.field(static=True)
    kernel: Literal["rbf", "matern12", "matern32", "matern52"] = eqx.field(static=True)
    sampling: Sampling = eqx.field(static=True)
    form: Literal["cos-sin", "phase"] = eqx.field(static=True)

    @override
    def count(self, observation_space: Space, action_space: Space) -> int:
        return self.num_features

    @override
    def draw(
        self, key: Key[Array, ""], observation_space: Space, action_space: Space, dtype: jnp.dtype
    ) -> FourierFeatures:
        num_observations, num_actions = observation_space.num_dims, action_space.num_dims
        key_frequencies, key_phases = jax.random.split(key)
        lengthscale = jnp.concatenate(
            [
                jnp.full((num_observations,), self.state_lengthscale, dtype),
                jnp.full((num_actions,), self.action_lengthscale, dtype),
            ]
        )
        has_sines = self.form == "cos-sin"
        features = RandomFourier.draw(
            key_frequencies,
            _KERNELS[self.kernel](lengthscale),
            self.num_features if has_sines else 2 * self.num_features,
            num_observations + num_actions,
            sampling=self.sampling,
        )
        frequencies, number = features.frequencies, len(features.frequencies)
        amplitude = jnp.asarray(number**-0.5, dtype)
        if has_sines:
            frequencies = jnp.concatenate([frequencies, frequencies])
            phases = jnp.concatenate([jnp.zeros((number,), dtype), jnp.full((number,), -0.5 * jnp.pi, dtype)])
        else:
            phases = jax.random.uniform(key_phases, (number,), dtype, maxval=2.0 * jnp.pi)
        of_state, of_action = jnp.split(frequencies, [num_observations], axis=1)
        return FourierFeatures(
            observation_space, action_space, of_state, of_action, phases, amplitude, has_sines
        )


class FourierBasisSpec(FeatureSpec):
    """The Fourier basis (5.23) of state and action, with bounds mapped to [0, 1].

    Settings: `bojax.learning.settings.FourierBasisFeatures`.
    """

    order: int = eqx.field(static=True)

    @override
    def check_spaces(self, observation_space: Space, action_space: Space) -> None:
        FEATURES.check(self.count(observation_space, action_space), "learner.features.order")

    @override
    def count(self, observation_space: Space, action_space: Space) -> int:
        return (self.order + 1) ** (observation_space.num_dims + action_space.num_dims)

    @override
    def draw(
        self, key: Key[Array, ""], observation_space: Space, action_space: Space, dtype: jnp.dtype
    ) -> FourierBasisMap:
        of_state, of_action = (
            jnp.asarray(FourierBasis(self.order, space.num_dims).frequencies(), dtype)
            for space in (observation_space, action_space)
        )
        return FourierBasisMap(observation_space, action_space, of_state, of_action)


class OneHotSpec(FeatureSpec):
    """One-hot features of discrete states and actions: linear function approximation of a table.

    Settings: `bojax.learning.settings.OneHot`.
    """

    @override
    def check_spaces(self, observation_space: Space, action_space: Space) -> None:
        _discrete(observation_space)
        _discrete(action_space)

    @override
    def draw(
        self, key: Key[Array, ""], observation_space: Space, action_space: Space, dtype: jnp.dtype
    ) -> OneHotFeatures:
        return OneHotFeatures(_discrete(observation_space), _discrete(action_space), jnp.ones((), dtype))


def _quarters(matrix: Float[Array, "M M"]) -> list[list[Float[Array, "F F"]]]:
    return [jnp.split(rows, 2, axis=1) for rows in jnp.split(matrix, 2)]


def _discrete(space: Space) -> Discrete:
    if not isinstance(space, Discrete):
        raise ValueError("features: got indicators; allowed only for discrete observations and actions")
    return space


_KERNELS = {"rbf": RBF, "matern12": Matern12, "matern32": Matern32, "matern52": Matern52}


class RBFFeatures(ProductFeatures):
    """Products of normalised radial basis functions of the state and of the action.

    x_i(s) = g_i(s) / |g(s)| with g_i(s) = exp(-|s - c_i|^2 / (2 w^2)), and y(a) likewise. Bounds are mapped
    to [0, 1], and values outside are clipped. phi is the outer product of x and y, of norm 1. Far from all
    centres, the function of the nearest one has the whole weight (normalised radial basis functions: Moody
    and Darken, Neural Computation 1, 1989, with a Euclidean norm in place of their sum).
    """

    observations: Space  # bounds of observations
    actions: Space  # space of actions
    state_centres: Float[Array, "P D"]  # centres in the observations, in [0, 1]
    action_centres: Float[Array, "R A"]  # centres in the actions, in [0, 1]
    state_width: Float[Array, ""]  # width of the functions of the state (w)
    action_width: Float[Array, ""]  # width of those of the action

    @property
    @override
    def num_features(self) -> int:
        return len(self.state_centres) * len(self.action_centres)

    @override
    def state(self, observation: Observation) -> Float[Array, "P"]:
        return _normalised(self.observations.to_unit(observation), self.state_centres, self.state_width)

    @override
    def action(self, action: Action) -> Float[Array, "R"]:
        if isinstance(self.actions, Discrete):
            return jax.nn.one_hot(action, self.actions.num, dtype=self.action_centres.dtype)
        return _normalised(self.actions.to_unit(action), self.action_centres, self.action_width)


class NormalisedRBFSpec(FeatureSpec):
    """Normalised radial basis functions around the points of scrambled Halton sequences.

    A width of 1 is the mean distance of neighbouring centres, N^(-1/D) for N centres in D dimensions.

    Settings: `bojax.learning.settings.NormalisedRBF`.
    """

    num_state_centres: int = eqx.field(static=True)
    num_action_centres: int = eqx.field(static=True)
    width: Float[Array, ""]

    @override
    def check_spaces(self, observation_space: Space, action_space: Space) -> None:
        FEATURES.check(self.count(observation_space, action_space), "learner.features")

    @override
    def count(self, observation_space: Space, action_space: Space) -> int:
        is_discrete = isinstance(action_space, Discrete)
        return self.num_state_centres * (action_space.num if is_discrete else self.num_action_centres)

    @override
    def draw(
        self, key: Key[Array, ""], observation_space: Space, action_space: Space, dtype: jnp.dtype
    ) -> RBFFeatures:
        key_state, key_action = jax.random.split(key)
        num_actions = self.count(observation_space, action_space) // self.num_state_centres
        spaces = (
            (key_state, self.num_state_centres, observation_space.num_dims),
            (key_action, num_actions, action_space.num_dims),
        )
        centres = [scrambled_halton(key, number, dims, dtype) for key, number, dims in spaces]
        widths = [self.width.astype(dtype) * number ** (-1.0 / dims) for _, number, dims in spaces]
        return RBFFeatures(observation_space, action_space, *centres, *widths)


def _normalised(
    unit: Float[Array, "D"], centres: Float[Array, "N D"], width: Float[Array, ""]
) -> Float[Array, "N"]:
    """The functions around all centres, divided by their Euclidean norm."""
    point = jnp.clip(unit, 0.0, 1.0).astype(centres.dtype)
    squares = jnp.sum((point[None, :] - centres) ** 2, axis=1)
    # Relative to the nearest centre: far from all of them, every function alone would underflow to 0.
    functions = jnp.exp(-0.5 * (squares - jnp.min(squares)) / width**2)
    return functions / jnp.linalg.norm(functions)
