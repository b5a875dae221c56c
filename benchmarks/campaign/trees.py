"""Settings and JSON as trees: the paths of their entries, and what is at a path."""

from typing import Any


def paths(tree: Any, path: tuple = ()) -> list[tuple]:
    """The paths of all entries, including mappings and lists."""
    entries = tree.items() if isinstance(tree, dict) else enumerate(tree) if isinstance(tree, list) else ()
    found = []
    for key, value in entries:
        found += [(*path, key), *paths(value, (*path, key))]
    return found


def at(tree: Any, path: tuple) -> Any:
    """The entry at a path."""
    for key in path:
        tree = tree[key]
    return tree


def assign(tree: Any, path: tuple, value: Any) -> None:
    """Replace the entry at a path."""
    at(tree, path[:-1])[path[-1]] = value
