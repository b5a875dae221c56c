"""Whether two trees are the same: bojax's flat arrays and the reference's linked nodes."""

import jax
import jax.numpy as jnp
import numpy as np

from bojax.planning.tree import UNVISITED
from bojax.problems.field_simulation import FieldNode

TOLERANCE = 1e-9


def nodes_of(root):
    """All nodes of a reference tree, the root first."""
    nodes, open_nodes = [], [root]
    while open_nodes:
        node = open_nodes.pop()
        nodes.append(node)
        open_nodes.extend(node.children)
    return nodes


def assert_same_tree(tree, root, num_actions):
    """Children, visits, rewards, returns, beliefs and ends of `tree` are those of the tree of `root`."""
    belief = jax.tree.map(jnp.asarray, tree.beliefs)
    poses = np.asarray(getattr(belief, "pose", belief))
    samples = np.asarray(belief.samples) if isinstance(belief, FieldNode) else None
    for node in nodes_of(root):
        where = f"node {node.index} at depth {node.depth}"
        children = [int(child) for child in tree.children[node.index] if child != UNVISITED]
        # A tree lists at most `num_actions` children; pattern search may have more than its tree lists.
        assert children == [child.index for child in node.children][:num_actions], where
        assert int(tree.visits[node.index]) == node.visits, where
        assert bool(tree.is_terminal[node.index]) == node.is_terminal, where
        numbers = [tree.reward[node.index], tree.total_return[node.index]]
        expected = [node.reward, node.total_return]
        if not node.is_terminal:  # where an episode ended nothing starts: the belief there is nobody's
            numbers += [*_pose(poses[node.index])]
            expected += [*_pose(getattr(node.belief, "pose", node.belief))]
            if samples is not None:
                _assert_same_samples(samples[node.index], node, len(root.belief.x), where)
        np.testing.assert_allclose(numbers, expected, rtol=TOLERANCE, atol=TOLERANCE, err_msg=where)


def _pose(pose):
    """x, y, and the heading as a direction: headings next to 0 and to 2 pi are near each other."""
    x, y, heading = pose
    return x, y, np.cos(heading), np.sin(heading)


def _assert_same_samples(samples, node, num_observations, where):
    """A node of a field's tree has imagined samples at the places of the reference's."""
    x, y, _, is_taken = samples.T
    points, imagined = np.stack([x, y], axis=-1)[is_taken > 0.0], node.belief.x[num_observations:]
    if node.children:  # at the horizon the last samples are not kept: nothing follows them
        assert len(points) == len(imagined), where
    np.testing.assert_allclose(points, imagined[: len(points)], atol=TOLERANCE, err_msg=where)
