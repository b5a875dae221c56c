"""The values of Sub Hunt with states observed, by backward induction over the target's way to its edge."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int


class Rules(NamedTuple):
    """Sub Hunt as tables over `P` positions, which are numbered from 0.

    The last two of `A` actions are to ping, which makes the target aware, and to engage.
    """

    own: Int[np.ndarray, "P A"]  # own position after each action
    targets: Int[np.ndarray, "P 4 T"]  # positions that the target may move to, for each of its directions
    probabilities: Float[np.ndarray, "T"]
    # For each direction, the positions at 0, 1, ... cells from the edge that ends the target's way
    lines: Int[np.ndarray, "4 K L"]
    # Probability that engaging kills a target that is not aware, and one that is
    kill: Float[np.ndarray, "P P 2"]
    kill_reward: float  # reward of a kill
    discount: float  # discount of the reward per step


_last: dict[tuple[bytes, ...], Float[np.ndarray, "P P 4 2 A"]] = {}


def solve(rules: Rules) -> Float[np.ndarray, "P P 4 2 A"]:
    """Optimal value of each action, by own position, the target's, its direction and whether it is aware.

    The array is kept for the next call with equal rules, such as that of another point of a sweep, and is
    read-only.
    """
    content = tuple(np.asarray(table).tobytes() for table in rules)
    found = _last.get(content)
    if found is None:
        found = _solve(rules)
        found.setflags(write=False)
        _last.clear()
        _last[content] = found
    return found


def _solve(rules: Rules) -> Float[np.ndarray, "P P 4 2 A"]:
    """Every move brings the target nearer to its edge, where values are 0, so that one pass is exact.

    Elementwise arithmetic of NumPy gives the same bytes on every machine; programs of XLA need not.
    """
    num, num_actions = rules.own.shape
    found = np.zeros((num, num, 4, 2, num_actions))
    for direction, lines in enumerate(rules.lines):
        values = np.zeros((num, num, 2))
        for line in lines[1:]:
            expected = np.zeros((num, len(line), 2))
            for targets, probability in zip(
                rules.targets[line, direction].T, rules.probabilities, strict=True
            ):
                expected += probability * values[:, targets]
            of_actions = _action_values(rules, rules.discount * expected, line)
            found[:, line, direction] = of_actions
            values[:, line] = of_actions.max(axis=-1)
    return found


def _action_values(
    rules: Rules, future: Float[np.ndarray, "P L 2"], line: Int[np.ndarray, "L"]
) -> Float[np.ndarray, "P L 2 A"]:
    """Value of each action, from the discounted value of what follows if the own position stays."""
    value = np.stack([future[own] for own in rules.own.T], axis=-1)
    value[:, :, 0, -2] = value[:, :, 1, -2]
    kill = rules.kill[:, line]
    value[..., -1] = kill * rules.kill_reward + (1.0 - kill) * value[..., -1]
    return value
