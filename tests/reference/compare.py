"""Whether two trees are the same: bojax's flat arrays and the reference's linked nodes."""

import numpy as np

from bojax.planning.tree import UNVISITED

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
            numbers += [*tree.belief[node.index]]
            expected += [*node.belief]
        np.testing.assert_allclose(numbers, expected, rtol=TOLERANCE, atol=TOLERANCE, err_msg=where)
